"""`servoj` of the stand-in: a stream is followed, and what happens when it falters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from tests.sim_backend.ur_controller.urscript.script_robot import READY, ScriptRobot
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.controller import Controller, ControllerOptions
from toolee_robot.sim_backend.ur_controller.process import resting_joints
from toolee_robot.sim_backend.ur_controller.profile import (
    CB3,
    E_SERIES,
    Profile,
    ProfileName,
    ServoLag,
    StopDecelerations,
)
from toolee_robot.sim_backend.ur_controller.profile import profile as machine_profile
from toolee_robot.sim_backend.ur_controller.robot.plant import UR10, UR10E, ControllerModel
from toolee_robot.sim_backend.ur_controller.robot.servoj import LaggingServoJ

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


BOTH = [(UR10, CB3), (UR10E, E_SERIES)]
both_of_lagging_servoj = pytest.mark.parametrize(("model", "profile"), BOTH, ids=["CB3", "e-Series"])
either_of_lagging_servoj = st.sampled_from(BOTH)
gains = st.floats(100.0, 2000.0)
lookaheads = st.floats(0.03, 0.2)


def lag_of(profile: Profile) -> ServoLag:
    assert profile.servo is not None
    return profile.servo


def stream(
    model: ControllerModel, profile: Profile, goals: Array, gain: float, lookahead: float, rate: float = 1.0
) -> Array:
    """Set-points, one row a tick, of a call of servoj in every tick; `rate` is the slider's."""
    q, qd, before, found = goals[0], np.zeros(6), None, []
    for goal in goals:
        motion = LaggingServoJ(model, lag_of(profile), goal, lookahead, gain)
        if before is not None:
            motion.follow(before)
        way = motion.step(q, qd, rate * model.period, model.period)
        q, qd, before = q + way, way / model.period, motion
        found.append(q)
    return np.array(found)


def ramp(model: ControllerModel, seconds: float, speed: float = 0.3) -> Array:
    """Goals that start gently and end at constant speed, (ticks, 6) [rad]."""
    t = np.arange(round(seconds * model.rate)) * model.period
    way = speed * np.where(t < 0.5, t**2, t - 0.25)
    return np.outer(way, [1.0, -1.0, 0.5, 1.0, 0.3, -0.7])


def measured_lag(model: ControllerModel, profile: Profile, gain: float, lookahead: float, rate: float = 1.0) -> float:
    """Lag at the end of a ramp [s]."""
    goals = ramp(model, 3.5)
    q = stream(model, profile, goals, gain, lookahead, rate)
    return float((goals[-1, 0] - q[-1, 0]) / 0.3)


@pytest.mark.parametrize(("model", "profile", "lag"), [(UR10, CB3, 0.054), (UR10E, E_SERIES, 0.034)])
def test_the_lag_is_the_profiles_at_the_gain_where_it_was_measured(
    model: ControllerModel, profile: Profile, lag: float
) -> None:
    assert measured_lag(model, profile, 1200.0, 0.03) == pytest.approx(lag, abs=1e-3)


@pytest.mark.parametrize("lag", [0.03, 0.05, 0.071, 0.12])
@both_of_lagging_servoj
def test_the_lag_is_a_labs_own_where_it_is_given(model: ControllerModel, profile: Profile, lag: float) -> None:
    changed = replace(profile, servo=lag_of(profile).with_lag(lag, model.period))
    assert measured_lag(model, changed, 1200.0, 0.03) == pytest.approx(lag, abs=1e-3)


@pytest.mark.parametrize("name", ["ideal", "harsh"])
@pytest.mark.parametrize("model", [UR10, UR10E], ids=["CB3", "e-Series"])
def test_a_controller_takes_a_labs_own_lag_and_stops(model: ControllerModel, name: ProfileName) -> None:
    stops = StopDecelerations(protective=8.0, safeguard=7.0, emergency=9.0)
    machine = Controller(
        ControllerOptions(model.name, profile=name, lag=0.071, stops=stops), resting_joints
    ).robot.machine
    assert machine.servo_lag is not None
    assert machine.servo_lag.lag(1200.0, 0.03, model.period) == pytest.approx(0.071, abs=1e-9)
    assert machine.stops == stops
    plain = Controller(ControllerOptions(model.name, profile=name), resting_joints).robot.machine
    assert plain.servo_lag == machine_profile(name, model.e_series).servo


@given(
    kind=either_of_lagging_servoj,
    gain=gains,
    lookahead=lookaheads,
    goals=st.lists(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6), min_size=1, max_size=3),
    rate=st.floats(0.2, 1.0),
)
@examples(6)
def test_any_goals_are_reached_within_the_limits_with_a_lag(
    kind: tuple[ControllerModel, Profile], gain: float, lookahead: float, goals: list[list[float]], rate: float
) -> None:
    """Stable over the whole range: jumps of the goal are followed within velocity and acceleration, and end there."""
    model, profile = kind
    ticks = round(0.2 * model.rate)
    path = [np.zeros(6)] + [np.array(goal) for goal in goals for _ in range(ticks)]
    # The farthest way at the scaled speed, from where the jumps before it have led, and eight lags.
    travel = 1.5 / (rate * min(model.velocity)) + 0.4
    settled = travel + 8.0 * lag_of(profile).lag(gain, lookahead, model.period) / rate
    path += [np.array(goals[-1])] * round(settled * model.rate)
    q = stream(model, profile, np.array(path), gain, lookahead, rate)
    np.testing.assert_allclose(q[-1], goals[-1], atol=1e-3)
    speeds = np.diff(q, axis=0) * model.rate
    assert np.all(np.abs(speeds) <= np.array(model.velocity) * (1 + 1e-6))
    change = np.abs(np.diff(speeds, axis=0)).max() * model.rate
    assert change <= 2.1 * model.acceleration, "halves of two ticks' changes may add up, no more"
    assert np.abs(q).max() < 4.0


@both_of_lagging_servoj
def test_at_half_the_slider_the_lag_is_longer_and_at_zero_the_arm_stands(
    model: ControllerModel, profile: Profile
) -> None:
    """The set-points of a stream do not wait for the slider: the arm falls behind them."""
    full = measured_lag(model, profile, 300.0, 0.1)
    assert measured_lag(model, profile, 300.0, 0.1, rate=0.5) > 1.7 * full
    goals = ramp(model, 1.0)
    np.testing.assert_array_equal(stream(model, profile, goals, 300.0, 0.1, rate=0.0)[-1], goals[0])
