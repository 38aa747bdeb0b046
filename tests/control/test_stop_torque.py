"""A stop on a path keeps the torques of the joints with what the flange carries, and takes no longer than it must."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.control.desk import TOOL, Desk
from tests.control.test_path_stop import ACCELERATION, JERK, PERIODS, check, driven, plans
from tests.examples import examples
from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, plan_strike
from toolee_robot.control.arm_dynamics import TORQUE_SHARE, ArmDynamics, permitted_braking
from toolee_robot.control.motion.path_stop import MIN_SHARE, stop_on_path
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.frames import Array, transform
from toolee_robot.station import StationConfig
from toolee_robot.types import ArmModel, Payload, Trajectory

__all__ = ["plans"]  # the fixture

RATED = np.array(ARM_DATA[ArmModel.UR10].torque)
HELD = transform(Rotation.from_euler("xyz", [11.56, 9.77, 178.49], degrees=True), [0.2542, -0.0288, 0.1504])
GRASP = np.array(
    [-0.126, 0.0, 0.0, 1.112, 1.102, 1.211, 0.0, 1.412, 0.905, 1.184, 0.0, 1.356, 0.954, 1.189, 0.0, 0.0, 1.133, 1.121,
     1.189, 0.301, 1.222, 0.18, -0.3, -0.593]
)  # fmt: skip
OVER_THE_NAIL = np.array([-0.169, -2.39, 2.283, -2.103, -1.473, -1.354])
"""The face in the hand, the hand, and the arm before the first strike of seed 7408, which a harsh UR10 stopped."""
SLACK = 0.02
"""Share of the torque by which a stop may exceed what is permitted: the bound is looked up once in a millisecond."""


def bounded(dynamics: ArmDynamics, trajectory: Trajectory) -> Trajectory:
    return replace(trajectory, braking=permitted_braking(dynamics, trajectory, TORQUE_SHARE * RATED))


def torque_share(dynamics: ArmDynamics, trajectory: Trajectory, start: float, period: float) -> float:
    """The largest share of a joint's torque that the commands of a stop take."""
    q, _ = driven(trajectory, start, period, stop_on_path(trajectory, start, period, ACCELERATION, JERK))
    qd, qdd = (q[2:] - q[:-2]) / (2 * period), np.diff(q, 2, axis=0) / period**2
    return float(np.max(np.abs(dynamics.torques(q[1:-1], qd, qdd)) / RATED))


@pytest.mark.parametrize("period", PERIODS)
def test_a_stop_behind_the_contact_keeps_the_torques(robot: RobotModel, config: StationConfig, period: float) -> None:
    world = CollisionWorld(robot, config, GRASP, HELD)
    nail = config.work.X_base_nail()
    plan = plan_strike(robot, config, world, OVER_THE_NAIL, GRASP, HELD, nail, tool=TOOL)
    dynamics = ArmDynamics(robot, GRASP, HELD, TOOL)
    strike = bounded(dynamics, plan.strike)
    without = []
    for late in (-0.05, 0.0, 0.04, 0.1):
        start = plan.contact_time + late
        assert torque_share(dynamics, strike, start, period) <= TORQUE_SHARE + SLACK
        without.append(torque_share(dynamics, plan.strike, start, period))
        # Never longer than the strike that was planned, whose braking was checked for collisions.
        assert check(strike, start, period, ACCELERATION, JERK) <= strike.duration - start + period
    assert max(without) > TORQUE_SHARE + 2 * SLACK, "no joint was near its torque: the test shows nothing"


@given(
    change=st.lists(st.floats(-1.2, 1.2), min_size=6, max_size=6).filter(lambda c: max(map(abs, c)) > 0.1),
    begin=st.tuples(st.floats(-0.6, 0.6), st.floats(-2.2, -0.8), st.floats(0.3, 2.2), st.floats(-2.0, 0.5)),
    share=st.floats(0.05, 0.95),
    mass=st.floats(0.0, 3.0),
    period=st.sampled_from(PERIODS),
)
@examples(30)
def test_any_stop_keeps_the_torques_where_they_permit_one(
    robot: RobotModel,
    q_hand: Array,
    change: list[float],
    begin: tuple[float, float, float, float],
    share: float,
    mass: float,
    period: float,
) -> None:
    q0 = np.array([*begin, -1.57, 0.0])
    full = np.ones(6)
    move = joint_move(q0, q0 + change, 2.0 * full, 0.8 * ACCELERATION * full, 400.0 * full)
    loaded = ArmDynamics(robot, q_hand, np.eye(4), Payload(mass, np.array([0.0, 0.0, 0.1])))
    move = bounded(loaded, move)
    assert move.braking is not None
    assume(np.min(move.braking) > 2 * MIN_SHARE * ACCELERATION * np.sqrt(6))
    planned = float(np.max(np.abs(loaded.torques(move.q, move.qd, move.qdd)) / RATED))
    start = share * move.duration
    assert torque_share(loaded, move, start, period) <= max(planned, TORQUE_SHARE) + 2 * SLACK
    # It brakes as hard as it may at once, which is not the fastest where less is permitted farther on.
    assert check(move, start, period, ACCELERATION, JERK) <= 1.1 * (move.duration - start) + period


@given(row=st.floats(0.0, 1.0), rate=st.floats(0.0, 1.0), mass=st.floats(0.0, 5.0))
@examples(60)
def test_the_permitted_braking_takes_the_torque_and_no_more(
    plans: list[StrikePlan], robot: RobotModel, q_hand: Array, row: float, rate: float, mass: float
) -> None:
    """At any share of the planned speed; at none of it and at all of it, one joint is at its torque."""
    strike = plans[0].strike
    loaded = ArmDynamics(robot, q_hand, np.eye(4), Payload(mass, np.array([0.05, 0.0, 0.1])))
    torque = TORQUE_SHARE * RATED
    still, planned = permitted_braking(loaded, strike, torque).T
    i = 1 + round(row * (len(strike.times) - 3))
    q, qd, qdd = strike.q[i], strike.qd[i], strike.qdd[i]
    e = qd / np.linalg.norm(qd)
    P = qdd - (e @ qdd) * e

    def share(r: float) -> float:
        braking = still[i] + r**2 * (planned[i] - still[i])
        tau = loaded.torques(q[None], r * qd[None], (r**2 * P - e * braking)[None])
        return float(np.max(np.abs(tau) / torque))

    assert share(rate) <= 1.0 + 1e-9
    assert share(0.0) == pytest.approx(1.0, abs=1e-6)
    assert share(1.0) == pytest.approx(1.0, abs=1e-6)


def test_what_does_not_move_has_no_bound(robot: RobotModel, q_hand: Array) -> None:
    dynamics = ArmDynamics(robot, q_hand, HELD, TOOL)
    still = np.zeros((3, 6))
    rest = bounded(dynamics, Trajectory(np.array([0.0, 0.004, 0.008]), still, still, still))
    assert list(stop_on_path(rest, rest.duration, 1 / 125, ACCELERATION, JERK)) == []


def test_the_supervisor_bounds_every_motion_by_the_payload_that_was_set(
    robot: RobotModel, config: StationConfig, home: Array, q_hand: Array, X_hand_ee: Array
) -> None:
    desk = Desk(robot, config, CollisionWorld(robot, config, q_hand, X_hand_ee), home)
    hand = robot.description.hand_payload(q_hand)
    bounds: list[Array | None] = []
    for payload in (None, hand, Payload(hand.mass + 4.0, hand.center_of_mass + np.array([0.0, 0.0, 0.2]))):
        if payload is not None:
            desk.supervisor.set_payload(payload)
        desk.supervisor.execute(desk.slow(0.2 if len(bounds) % 2 == 0 else -0.2))
        bounds.append(desk.arm.moves[-1].braking)
    nothing_set, empty, loaded = bounds
    assert nothing_set is not None
    assert empty is not None
    assert loaded is not None
    assert np.min(nothing_set) == pytest.approx(np.min(empty), rel=0.3)
    assert np.min(loaded) < 0.8 * np.min(empty)
