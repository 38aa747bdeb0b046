"""A stop on the path: on it, within the limits, to rest, and hardly slower than the fastest one there is."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from tests.control.desk import TOOL, Desk
from tests.examples import examples, seldom
from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, plan_strike
from toolee_robot.control.arm_dynamics import TORQUE_SHARE, ArmDynamics, permitted_braking
from toolee_robot.control.motion.path_stop import MIN_SHARE, PathStop, stop_on_path
from toolee_robot.control.planning import timing
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.frames import Array, transform
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.station import StationConfig, sim_station
from toolee_robot.types import ArmModel, Payload, Trajectory

ACCELERATION, JERK = float(sim_station().arm.stop_acceleration.max()), sim_station().arm.stop_jerk
PERIODS = (1 / 125, 1 / 500)
OWN = 1 / 3
"""Times the step of a trajectory's samples and its own jerk: what cubic interpolation between them adds to the
acceleration, where the jerk switches between two samples. The stop keeps the limits by itself."""
TURNING = 1.3
"""Share of the jerk limit that a stop on a swing may take for a cycle or two, where joints turn about."""
FINE = 1e-4
"""[s] Step of samples between which interpolation adds next to nothing."""


@pytest.fixture(scope="module")
def plans(robot: RobotModel, config: StationConfig, home: Array, q_hand: Array, X_tool_ee: Array) -> list[StrikePlan]:
    rng, plans = np.random.default_rng(4), []
    for _ in range(6):
        turn = Rotation.from_euler("ZYX", rng.uniform([-25, -12, -12], [25, 12, 12]), degrees=True)
        X_hand_ee = SHADOW_HAND.grasp.X_hand_tool(0.016) @ transform(turn, [0, 0, rng.uniform(-0.03, 0.03)]) @ X_tool_ee
        world = CollisionWorld(robot, config, q_hand, X_hand_ee)
        nail = config.work.X_base_nail(rng.uniform(0, 0.02))
        plans.append(plan_strike(robot, config, world, home, q_hand, X_hand_ee, nail, tool=TOOL))
    return plans


def driven(trajectory: Trajectory, start: float, period: float, brake: PathStop) -> tuple[Array, Array]:
    """Commanded q (N, n) from three cycles before the stop to two after it, and the positions on the trajectory."""
    q = [trajectory.sample(start - k * period)[0] for k in (3, 2, 1, 0)]
    s = [start]
    last = None
    for row, qd in brake:
        q.append(row)
        s.append(brake.state.position)
        np.testing.assert_allclose(row, trajectory.sample(brake.state.position)[0], atol=1e-12)
        last = qd
    assert last is None or not last.any(), "it ends at rest"
    return np.array([*q, q[-1], q[-1]]), np.array(s)


def check(
    trajectory: Trajectory, start: float, period: float, acceleration: float | Array, jerk: float, turning: float = 1.0
) -> float:
    """Drive the stop, assert what it promises, and return its duration [s]."""
    brake = stop_on_path(trajectory, start, period, acceleration, jerk)
    q, s = driven(trajectory, start, period, brake)
    assert np.all(np.diff(s) >= 0.0), "never backwards"
    assert np.all(s <= start + period * np.arange(len(s)) + 1e-9), "never ahead of the trajectory"
    rough = OWN * np.abs(np.diff(trajectory.qdd, axis=0)).max()
    assert np.all(np.abs(np.diff(q, 2, axis=0)).max(axis=0) <= (acceleration + rough) * period**2)
    # Each third difference is that of two second ones, a cycle apart.
    assert np.abs(np.diff(q, 3, axis=0)).max() <= (turning * jerk + 2.0 * rough / period) * period**3
    return (len(s) - 1) * period


@pytest.mark.parametrize("period", seldom(*PERIODS))
def test_a_strike_is_stopped_anywhere_on_its_way(plans: list[StrikePlan], period: float) -> None:
    for plan in plans:
        for start in np.linspace(0.0, plan.strike.duration, 14):
            check(plan.strike, start, period, ACCELERATION, JERK, TURNING)


@given(
    change=st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6).filter(lambda c: max(map(abs, c)) > 0.01),
    share=st.floats(0.0, 1.0),
    period=st.sampled_from(PERIODS),
    acceleration=st.lists(st.floats(3.0, 15.0), min_size=6, max_size=6),
    jerk=st.floats(100.0, 2000.0),
)
@example(change=[0.0, 0.0, 0.0, 0.0, 0.0, 1.1875], share=0.171875, period=1 / 500, acceleration=[12.0] * 6, jerk=100.0)
@settings(examples(20), report_multiple_bugs=False)
def test_any_move_is_stopped_within_any_limits_of_the_joints_that_it_keeps_itself(
    change: list[float], share: float, period: float, acceleration: list[float], jerk: float
) -> None:
    full, limits = np.ones(6), np.array(acceleration)
    with mock.patch.object(timing, "SAMPLE_PERIOD", FINE):
        move = joint_move(np.zeros(6), np.array(change), 2.0 * full, 0.95 * limits, 0.6 * jerk * full)
    check(move, share * move.duration, period, limits, jerk)


@given(
    start=st.floats(0.05, 0.5),
    first=st.integers(1, 12),
    limits=st.tuples(st.floats(2.0, 20.0), st.floats(50.0, 2000.0)),
)
@examples(40)
def test_a_second_stop_takes_over_where_the_first_one_is(
    plans: list[StrikePlan], start: float, first: int, limits: tuple[float, float]
) -> None:
    """A gentle stop, then a hard one: together no slower than the gentle one alone, and no jolt where they meet."""
    strike, period = plans[0].strike, 1 / 125
    alone = sum(1 for _ in stop_on_path(strike, start, period, *limits))
    rows = [strike.sample(start - k * period)[0] for k in (2, 1, 0)]
    gentle = stop_on_path(strike, start, period, *limits)
    for _ in range(min(first, alone)):
        rows.append(next(gentle)[0])
    hard = stop_on_path(strike, 0.0, period, 20.0, 2000.0, state=gentle.state)
    rows += [q for q, _ in hard]
    q = np.array([*rows, rows[-1], rows[-1]])
    assert len(rows) - 3 <= alone + 1
    assert hard.state.speed == 0.0
    # A swing turns joints about while the gentle stop lets it go on: up to 22.2 in 350 draws.
    assert np.abs(np.diff(q, 2, axis=0)).max() <= 1.15 * 20.0 * period**2
    assert np.abs(np.diff(q, 3, axis=0)).max() <= 1.05 * 2000.0 * period**3


def test_a_trajectory_that_breaks_the_limits_itself_still_comes_to_rest(plans: list[StrikePlan]) -> None:
    for start in np.linspace(0.0, 0.5, 6):
        brake = stop_on_path(plans[0].strike, start, 1 / 125, 1.0, 20.0)
        _, s = driven(plans[0].strike, start, 1 / 125, brake)
        assert len(s) < 125


def test_nothing_is_left_to_stop_at_the_end_and_little_where_nothing_moves() -> None:
    still = np.zeros((2, 6))
    rest = Trajectory(np.array([0.0, 0.004]), still, still, still)
    assert list(stop_on_path(rest, rest.duration, 1 / 125, 15.0, 1500.0)) == []
    assert len(list(stop_on_path(rest, 0.0, 1 / 125, 15.0, 1500.0))) == 1


def fastest(trajectory: Trajectory, start: float, within: float, step: float) -> float:
    """Duration of the fastest stop within the limits [s], on a grid of `step` [s], by linear programmes."""
    n = round(within / step)
    while n > 2 and _feasible(trajectory, start, n, step):
        n -= 1
    return (n + 1) * step


def _feasible(trajectory: Trajectory, start: float, n: int, h: float) -> bool:
    ago = np.arange(1, n + 1)[:, None] - np.arange(n)[None, :]
    gone = np.where(ago > 0, ago, 0)
    to_a, to_r = h * (gone > 0), h**2 * np.where(ago > 0, gone - 0.5, 0)
    to_s = h**3 * np.where(ago > 0, (gone**2 - gone) / 2 + 1 / 6, 0)
    to_a, to_r, to_s = (np.vstack([np.zeros(n), m]) for m in (to_a, to_r, to_s))
    x = (np.arange(n) + 0.5) / n
    u = np.gradient(6 * (x**2 - x) / (n * h), h)
    t = trajectory.times
    for _ in range(8):
        a, r = to_a @ u, 1 + to_r @ u
        s = start + h * np.arange(n + 1) + to_s @ u
        q_s, q_ss = (
            np.stack([np.interp(s, t, x[:, i]) for i in range(6)], axis=1) for x in (trajectory.qd, trajectory.qdd)
        )
        q_sss = np.gradient(q_ss, s + 1e-9 * np.arange(n + 1), axis=0)
        qdd = q_ss * r[:, None] ** 2 + q_s * a[:, None]
        excess = max(np.abs(qdd).max() / ACCELERATION, np.abs(np.diff(qdd, axis=0)).max() / (h * JERK))
        if excess < 1.002 and abs(r[-1]) < 1e-3 and abs(a[-1]) < 0.02:
            return True
        rows, bounds = [-to_r], [np.ones(n + 1)]
        for i in np.flatnonzero(np.abs(q_s).max(axis=0) > 1e-3):
            G = (q_sss[:, i] * r**2 + q_ss[:, i] * a)[:, None] * to_s
            G += (2 * q_ss[:, i] * r)[:, None] * to_r + q_s[:, i][:, None] * to_a
            c = qdd[:, i] - G @ u
            rate, drift = np.diff(G, axis=0) / h, np.diff(c) / h
            rows += [G, -G, rate, -rate]
            bounds += [ACCELERATION - c, ACCELERATION + c, JERK - drift, JERK + drift]
        ends, goal = np.vstack([to_a[-1], to_r[-1]]), np.array([0.0, -1.0])
        A = np.vstack(rows)
        slack = -np.ones((len(A), 1))
        slack[: n + 1] = 0.0
        found = linprog(
            np.append(np.zeros(n), 1.0), np.hstack([A, slack * JERK]), np.concatenate(bounds),
            np.hstack([ends, np.zeros((2, 1))]), goal, bounds=[(None, None)] * n + [(0, None)], method="highs",
        )  # fmt: skip
        if found.status != 0:
            return False
        u = found.x[:n]
    return False


@pytest.mark.parametrize("share", seldom(1.0, 0.3, 0.7, 1.2))
def test_no_stop_is_two_cycles_slower_than_the_fastest_one(plans: list[StrikePlan], share: float) -> None:
    """Two cycles of the faster controller: from the middle of the run-up, still accelerating, to behind the contact."""
    for plan in plans[:2]:
        start = share * plan.contact_time
        ours = check(plan.strike, start, 1 / 500, ACCELERATION, JERK, TURNING)
        best = fastest(plan.strike, start, ours, 0.002)
        assert best <= ours + 1 / 500 + 1e-9, "the fastest one keeps the jerk everywhere"
        assert ours - best <= 2 / 500 + 1e-9
        coarse = check(plan.strike, start, 1 / 125, ACCELERATION, JERK, TURNING)
        assert coarse - best <= 2 / 125 + 1e-9


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


@pytest.mark.parametrize("period", seldom(*PERIODS))
def test_a_stop_behind_the_contact_keeps_the_torques(robot: RobotModel, config: StationConfig, period: float) -> None:
    deep = replace(config, strike=replace(config.strike, deepest=0.1))  # the fastest strikes ask for the most
    world = CollisionWorld(robot, deep, GRASP, HELD)
    nail = config.work.X_base_nail()
    plan = plan_strike(robot, deep, world, OVER_THE_NAIL, GRASP, HELD, nail, tool=TOOL)
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
    # The swing is planned for a lighter tool: with a heavy one it may itself take more than the torques.
    assume(np.all(np.abs(loaded.torques(q[None], qd[None], qdd[None])) <= torque))
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
