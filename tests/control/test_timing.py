"""Ruckig's ramps and joint moves: exact ends, limits, no backing up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.control.desk import TOOL
from tests.control.test_path_stop import GRASP, HELD, OVER_THE_NAIL
from tests.errors import raises
from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, check_trajectory, plan_strike
from toolee_robot.control.arm_dynamics import ArmDynamics
from toolee_robot.control.planning.timing import concatenate, joint_move
from toolee_robot.errors import LimitError
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import profile
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.sim_backend.ur_controller.robot.servoj import LaggingServoJ
from toolee_robot.station import SceneConfig, ServoConfig, StationConfig, sim_station
from toolee_robot.types import ArmModel, Trajectory


def test_joint_move_is_straight_and_within_limits() -> None:
    a, b = np.zeros(6), np.array([1.0, -0.5, 0.2, 2.0, 0.0, -1.0])
    velocity, acceleration, jerk = np.full(6, 0.8), np.full(6, 3.0), np.full(6, 30.0)
    move = joint_move(a, b, velocity, acceleration, jerk)
    assert np.allclose(move.q[0], a)
    assert np.allclose(move.q[-1], b)
    assert np.allclose(move.qd[[0, -1]], 0, atol=1e-9)
    share = move.q[:, 3] / 2.0
    assert np.allclose(move.q, share[:, None] * b, atol=1e-9)
    assert np.max(np.abs(move.qd)) <= 0.8 + 1e-9
    assert np.max(np.abs(np.gradient(move.q, move.times, axis=0) - move.qd)) < 0.01


def test_concatenate_joins_and_refuses_a_gap() -> None:
    limits = (np.full(6, 0.8), np.full(6, 3.0), np.full(6, 30.0))
    first = joint_move(np.zeros(6), np.ones(6), *limits)
    second = joint_move(np.ones(6), np.zeros(6), *limits)
    both = concatenate(first, second)
    assert both.duration == pytest.approx(first.duration + second.duration)
    assert np.allclose(both.q[-1], 0)
    with pytest.raises(ValueError, match="do not join"):
        concatenate(first, first)


@pytest.fixture
def move(home: Array) -> Trajectory:
    limits = (np.full(6, 0.8), np.full(6, 3.0), np.full(6, 30.0))
    return joint_move(home, home + 0.3, *limits)


def altered(move: Trajectory, **changes: Array) -> Trajectory:
    parts = {"times": move.times, "q": move.q, "qd": move.qd, "qdd": move.qdd, **changes}
    return Trajectory(**parts)


def test_checker_passes_a_good_move_and_names_what_is_wrong(
    robot: RobotModel, config: StationConfig, move: Trajectory
) -> None:
    def check(trajectory: Trajectory, scene: SceneConfig = config.scene) -> None:
        check_trajectory(trajectory, robot.arm, config.arm, scene)

    check(move)
    broken = move.q.copy()
    broken[5, 2] = np.nan
    with raises(LimitError, code="limit.not_finite"):
        check(altered(move, q=broken))
    with raises(LimitError, code="limit.duration"):
        check(altered(move, times=move.times * 1e3))
    with raises(LimitError, code="limit.velocity"):
        check(altered(move, qd=move.qd * 10))
    with raises(LimitError, code="limit.acceleration"):
        check(altered(move, qdd=move.qdd * 10))
    with raises(LimitError, code="limit.position") as raised:
        check(altered(move, q=move.q + np.array([0, 0, 3.0, 0, 0, 0])))
    assert "joint 3" in str(raised.value)
    step = move.q.copy()
    step[40:, 3] += 0.2
    with raises(LimitError, code="limit.velocity_between_samples"):
        check(altered(move, q=step))
    started = move.qd.copy()
    started[0] = 0.1
    with raises(LimitError, code="limit.not_at_rest"):
        check(altered(move, qd=started))
    with raises(LimitError, code="limit.flange_position") as raised:
        check(move, replace(sim_station().scene, workspace_upper=(1.2, 1.2, 0.3)))
    assert "of z" in str(raised.value)


SHARP = (1200.0, 0.03)
DEFAULTS = (ServoConfig().gain, ServoConfig().lookahead)


@pytest.fixture(scope="module", params=list(ArmModel))
def struck(request: pytest.FixtureRequest) -> tuple[ArmModel, StrikePlan, ArmDynamics]:
    config = sim_station()
    config = replace(config, arm=replace(config.arm, model=request.param))
    robot = RobotModel.of_station(config)
    world = CollisionWorld(robot, config, GRASP, HELD)
    nail = config.work.X_base_nail()
    plan = plan_strike(robot, config, world, OVER_THE_NAIL, GRASP, HELD, nail, tool=TOOL)
    return request.param, plan, ArmDynamics(robot, GRASP, HELD, TOOL)


def followed(model: ArmModel, goals: Array, period: float, gain: float, lookahead: float) -> Array:
    """Where a harsh controller's joints go for these commands, one a cycle."""
    servo = profile("harsh", e_series=model is ArmModel.UR10E).servo
    assert servo is not None
    q, qd, rows = goals[0], np.zeros(6), [goals[0]]
    last = LaggingServoJ(MODELS[model.value], servo, goals[0], lookahead, gain)
    for goal in goals:
        motion = LaggingServoJ(MODELS[model.value], servo, goal, lookahead, gain)
        motion.follow(last)
        way = motion.step(q, qd, period, period)
        q, qd, last = q + way, way / period, motion
        rows.append(q)
    return np.array(rows)


def worst_share(struck: tuple[ArmModel, StrikePlan, ArmDynamics], servo: tuple[float, float], gap: float) -> float:
    """The largest share of a joint's torque in a strike whose commands stop for `gap` [s], at the worst moment."""
    model, plan, dynamics = struck
    period, strike = MODELS[model.value].period, plan.strike
    times = np.arange(period, strike.duration + period, period)
    path = np.array([strike.sample(t)[0] for t in times])
    shares = []
    for at in np.linspace(0.4, 0.8, 7):
        i = int(at * len(path))
        held, rest = np.repeat(path[i - 1 : i], round(gap / period), 0), np.repeat(path[-1:], int(0.4 / period), 0)
        q = followed(model, np.concatenate([path[:i], held, path[i:], rest]), period, *servo)
        qd, qdd = (q[2:] - q[:-2]) / (2 * period), np.diff(q, 2, axis=0) / period**2
        shares.append(np.max(np.abs(dynamics.torques(q[1:-1], qd, qdd)) / ARM_DATA[model].torque))
    return float(max(shares))


def test_a_sharp_servo_bears_no_gap_and_the_default_one_twenty_milliseconds(
    struck: tuple[ArmModel, StrikePlan, ArmDynamics],
) -> None:
    assert worst_share(struck, SHARP, 0.0) < 0.92
    assert worst_share(struck, SHARP, 0.024) > 1.0, "3 cycles of a CB3, 12 of an e-Series: the controller stops it"
    for gap in (0.006, 0.02):
        assert worst_share(struck, DEFAULTS, gap) < 0.92
    assert worst_share(struck, DEFAULTS, 0.04) < 1.0, "above 1 the controller stops it"
