"""What a strike asks of the arm, from its report: against the plan, the robot's ratios, and the gate that follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.control.test_swing import RATED, torques
from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, plan_strike
from toolee_robot.control.arm_dynamics import StrikeLoad, strike_load
from toolee_robot.frames import Array
from toolee_robot.hal import MotionOutcome, MotionReport
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel, JointState, Payload

CONFIG = sim_station()


@pytest.fixture(scope="module")
def struck(X_tool_ee: Array, home: Array) -> tuple[RobotModel, StrikePlan, Array, Array, Payload]:
    robot = RobotModel.of_station(CONFIG)
    q_hand, tool = robot.description.hand_closed, Payload(1.05, np.array([0.06, 0.0, -0.05]))
    X_hand_ee = SHADOW_HAND.grasp.X_hand_tool(0.016) @ X_tool_ee
    world = CollisionWorld(robot, CONFIG, q_hand, X_hand_ee)
    plan = plan_strike(robot, CONFIG, world, home, q_hand, X_hand_ee, CONFIG.work.X_base_nail(), tool=tool)
    payload = robot.payload(q_hand, X_hand_ee, tool.mass, tool.center_of_mass)
    return robot, plan, q_hand, X_hand_ee, payload


def report_of(plan: StrikePlan, rate: float, jitter: float = 0.0) -> MotionReport:
    t = np.arange(0.0, plan.strike.duration + 0.1, 1 / rate)
    q = np.array([plan.strike.sample(min(s, plan.strike.duration))[0] for s in t])
    t = t + np.random.default_rng(0).uniform(0.0, jitter, len(t))
    contact = JointState(plan.q_contact, np.zeros(6), plan.contact_time)
    wrenches = np.zeros((len(t), 6))
    wrenches[(t > plan.contact_time) & (t < plan.contact_time + 0.02), 2] = 50.0
    return MotionReport(MotionOutcome.CONTACT, t, q, q, wrenches, contact)


@pytest.mark.parametrize("rate", [125.0, 500.0])
def test_a_strikes_torque_is_that_of_its_plan(
    struck: tuple[RobotModel, StrikePlan, Array, Array, Payload], rate: float
) -> None:
    """Against the inverse dynamics of the whole hand: as measured, with stamps that jitter by a millisecond."""
    robot, plan, q_hand, X_hand_ee, payload = struck
    report = report_of(plan, rate, jitter=0.001)
    load = strike_load(replace(report, wrenches=np.zeros_like(report.wrenches)), robot, q_hand, payload, ArmModel.UR10)
    expected = float(np.max(torques(robot, plan, q_hand, X_hand_ee) / RATED))
    assert load.torque_share == pytest.approx(expected, rel=0.08)
    assert 0.4 < expected < 1.0


def test_impulse_and_ratios_are_the_reports(struck: tuple[RobotModel, StrikePlan, Array, Array, Payload]) -> None:
    robot, plan, q_hand, _, payload = struck
    plain = report_of(plan, 500.0)
    ratios = np.linspace(0.0, 0.7, len(plain.stamps))
    report = replace(plain, position_deviation_ratios=ratios, collision_ratios=0.5 * ratios)
    load = strike_load(report, robot, q_hand, payload, ArmModel.UR10)
    assert load.impulse == pytest.approx(50.0 * 0.02, rel=0.15)
    assert load.position_deviation_ratio == pytest.approx(0.7)
    assert load.collision_ratio == pytest.approx(0.35)
    missed = strike_load(replace(plain, contact=None), robot, q_hand, payload, ArmModel.UR10)
    assert (missed.impulse, missed.position_deviation_ratio, missed.collision_ratio) == (0.0, None, None)


@pytest.mark.parametrize(
    ("load", "says"),
    [
        (StrikeLoad(3.0, 0.9), ""),
        (StrikeLoad(3.0, 0.9, 0.6, 0.6), ""),
        (StrikeLoad(3.0, 0.9, 0.61, 0.1), "position deviation"),
        (StrikeLoad(3.0, 0.9, float("nan"), 0.1), "position deviation"),
        (StrikeLoad(3.0, 0.9, 0.1, 0.99), "collision"),
        (StrikeLoad(3.0, 1.01, None, None), "torque"),
    ],
)
def test_no_strike_follows_one_that_nearly_stopped_the_robot(load: StrikeLoad, says: str) -> None:
    excess = load.excess(sim_station().strike)
    assert (says in excess) if says else not excess
    assert not says or "lower" in excess
