"""What a strike takes of the joints' torques when commands are missing, followed as by a harsh controller."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.control.desk import TOOL
from tests.control.test_stop_torque import GRASP, HELD, OVER_THE_NAIL
from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, plan_strike
from toolee_robot.control.arm_dynamics import ArmDynamics
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import profile
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.sim_backend.ur_controller.robot.servoj import LaggingServoJ
from toolee_robot.station import ServoConfig, sim_station
from toolee_robot.types import ArmModel

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
    assert worst_share(struck, SHARP, 0.024) > 1.2, "3 cycles of a CB3, 12 of an e-Series: the controller stops it"
    for gap in (0.006, 0.02):
        assert worst_share(struck, DEFAULTS, gap) < 0.92
    assert worst_share(struck, DEFAULTS, 0.04) < 1.0, "above 1 the controller stops it"
