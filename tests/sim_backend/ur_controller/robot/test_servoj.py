"""`servoj` of the stand-in: a stream is followed, and what happens when it falters."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from tests.sim_backend.ur_controller.urscript.script_robot import READY, ScriptRobot
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot.plant import UR10, UR10E, ControllerModel

both = pytest.mark.parametrize("model", [UR10, UR10E], ids=lambda m: m.name)
either = st.sampled_from([UR10, UR10E])
shares = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(np.array)

STREAM = """def a():
  thread servo():
    while True:
      q = [0, 0, 0, 0, 0, 0]
      i = 0
      while i < 6:
        q[i] = read_input_float_register(i)
        i = i + 1
      end
      servoj(q, t=get_target(), lookahead_time=0.1, gain=300)
    end
  end
  def get_target():
    return read_input_float_register(6)
  end
  t = run servo()
  while read_input_integer_register(0) == 0:
    sync()
  end
  kill t
  stopj(10)
end"""


@both
def test_servoj_is_where_it_was_told_one_tick_later(model: ControllerModel) -> None:
    """A swing at up to 8 rad/s^2: the joints equal the stream to 1e-6 rad, the lag being the tick it took."""
    robot = ScriptRobot(model)
    period = model.period
    t = np.arange(round(2.0 / period)) * period
    swing = 0.5 * 2.0 / np.pi * (1 - np.cos(np.pi * t / 2.0 * 2)) / 2
    stream = np.array(READY) + np.outer(swing, [0.2, 1.0, -1.0, 0.5, 0.7, 0.3])
    robot.registers.float_in[:7] = [*READY, period]
    robot.start(STREAM)
    for q in stream:
        robot.registers.float_in[:6] = q.tolist()
        robot.tick()
        np.testing.assert_allclose(robot.plant.q, q, atol=1e-6)
    assert np.abs(robot.speeds()[10:]).max() == pytest.approx(0.5, rel=0.02)


@both
def test_a_step_of_servoj_is_walked_not_jumped(model: ControllerModel) -> None:
    robot = ScriptRobot(model)
    goal = np.add(READY, [0.5, -0.2, 0.1, 0.0, 0.05, 1.0])
    robot.registers.float_in[:7] = [*goal.tolist(), model.period]
    robot.start(STREAM)
    robot.tick(round(1.5 * model.rate))
    np.testing.assert_allclose(robot.plant.q, goal, atol=1e-6)
    assert np.all(np.abs(robot.speeds()).max(axis=0) <= np.array(model.velocity) * (1 + 1e-6))
    assert np.abs(np.diff(robot.speeds(), axis=0)).max() * model.rate <= model.acceleration * (1 + 1e-6)
    trace = np.array(robot.trace)
    low, high = np.minimum(READY, goal), np.maximum(READY, goal)
    grain = model.acceleration * model.period**2 / 4  # what the speed changes in one tick is worth
    assert np.all(trace >= low - grain)
    assert np.all(trace <= high + grain)


def test_servoj_over_a_longer_time_is_even() -> None:
    robot = ScriptRobot(UR10E)
    robot.start("def a():\n servoj([0.3, -1.4, 1.6, -1.8, -1.5, 0.25], t=0.1)\n sleep(1)\nend")
    robot.tick(25)
    assert robot.plant.q[5] == pytest.approx(0.2 + 0.05 / 2, abs=2e-3)
    robot.tick(25)
    assert robot.plant.q[5] == pytest.approx(0.25, abs=1e-3)
    robot.tick(200)  # nothing refreshes it: it waits at its goal
    assert robot.plant.q[5] == pytest.approx(0.25, abs=1e-9)
    assert not robot.machine.moving


def streaming(model: ControllerModel) -> ScriptRobot:
    """A robot whose script sends what is in the registers to servoj, tick by tick."""
    robot = ScriptRobot(model)
    robot.registers.float_in[:7] = [*READY, model.period]
    robot.start(STREAM)
    return robot


def assert_within_limits(robot: ScriptRobot) -> None:
    speeds = robot.speeds()
    assert np.all(np.abs(speeds).max(axis=0) <= np.array(robot.model.velocity) * (1 + 1e-6))
    assert np.abs(np.diff(speeds, axis=0)).max() * robot.model.rate <= robot.model.acceleration * (1 + 1e-6)


@given(shares, st.floats(0.2, 2.0), st.floats(0.05, 0.4), either)
@examples(25)
def test_a_stream_that_ends_in_mid_motion_is_passed_in_its_own_direction(
    share: Array, top: float, ramp: float, model: ControllerModel
) -> None:
    """However unlike the joints' speeds: the arm goes on along the line of its last motion, and comes back on it."""
    robot = streaming(model)
    speed = share * top * 0.9
    q = np.array(READY)
    for k in range(round(ramp * model.rate)):
        q = q + speed * (min(1.0, (k + 1) / (0.05 * model.rate)) * model.period)
        robot.registers.float_in[:6] = q.tolist()
        robot.tick()
    before = len(robot.trace)
    robot.tick(round(0.6 * model.rate))
    beyond = np.array(robot.trace[before:]) - q
    along = np.outer(beyond @ speed / (float(speed @ speed) + 1e-30), speed)
    np.testing.assert_allclose(beyond, along, atol=1e-9)
    most = np.abs(speed).max()
    assert np.abs(beyond).max() <= most**2 / (2 * model.acceleration) + most * model.period
    np.testing.assert_allclose(robot.plant.q, q, atol=1e-6)
    assert_within_limits(robot)


@given(shares, st.lists(st.booleans(), min_size=30, max_size=30), either)
@examples(25)
def test_a_late_packet_costs_a_few_ticks(share: Array, late: list[bool], model: ControllerModel) -> None:
    """Each packet may come together with the next one; after the last late one the stream is followed exactly again."""
    robot = streaming(model)
    speed = share * 1.8
    q = np.array(READY)
    ramp = round(0.1 * model.rate)
    for k in range(ramp + 40):
        q = q + speed * (min(1.0, (k + 1) / ramp) * model.period)
        if not (0 <= k - ramp < 30 and late[k - ramp] and not late[k - ramp - 1]):
            robot.registers.float_in[:6] = q.tolist()
        robot.tick()
    np.testing.assert_allclose(robot.plant.q, q, atol=1e-6)
    assert_within_limits(robot)


@given(st.lists(st.tuples(shares, st.integers(1, 60)), min_size=1, max_size=6), either)
@examples(25)
def test_any_goals_are_reached_within_the_limits(goals: list[tuple[Array, int]], model: ControllerModel) -> None:
    """Jumps of the goal in every direction, while the arm still moves for the one before."""
    robot = streaming(model)
    goal = np.array(READY)
    for share, ticks in goals:
        goal = np.array(READY) + 0.4 * share
        robot.registers.float_in[:6] = goal.tolist()
        robot.tick(ticks)
    robot.tick(round(1.5 * model.rate))
    np.testing.assert_allclose(robot.plant.q, goal, atol=1e-6)
    np.testing.assert_allclose(robot.plant.qd, 0.0, atol=1e-6)
    assert_within_limits(robot)
