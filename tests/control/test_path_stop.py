"""A stop on the path: on it, within the limits, to rest, and hardly slower than the fastest one there is."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from tests.control.desk import TOOL
from tests.examples import examples
from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, plan_strike
from toolee_robot.control.motion.path_stop import PathStop, stop_on_path
from toolee_robot.control.planning import timing
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.frames import Array, transform
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.station import StationConfig
from toolee_robot.types import Trajectory

ACCELERATION, JERK = 15.0, 1500.0
PERIODS = (1 / 125, 1 / 500)
OWN = 1 / 3
"""Times the step of a trajectory's samples and its own jerk: what cubic interpolation between them adds to the
acceleration, where the jerk switches between two samples. The stop keeps the limits by itself."""
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


def check(trajectory: Trajectory, start: float, period: float, acceleration: float, jerk: float) -> float:
    """Drive the stop, assert what it promises, and return its duration [s]."""
    brake = stop_on_path(trajectory, start, period, acceleration, jerk)
    q, s = driven(trajectory, start, period, brake)
    assert np.all(np.diff(s) >= 0.0), "never backwards"
    assert np.all(s <= start + period * np.arange(len(s)) + 1e-9), "never ahead of the trajectory"
    rough = OWN * np.abs(np.diff(trajectory.qdd, axis=0)).max()
    assert np.abs(np.diff(q, 2, axis=0)).max() <= (acceleration + rough) * period**2
    # Each third difference is that of two second ones, a cycle apart.
    assert np.abs(np.diff(q, 3, axis=0)).max() <= (jerk + 2.0 * rough / period) * period**3
    return (len(s) - 1) * period


@pytest.mark.parametrize("period", PERIODS)
def test_a_strike_is_stopped_anywhere_on_its_way(plans: list[StrikePlan], period: float) -> None:
    for plan in plans:
        for start in np.linspace(0.0, plan.strike.duration, 14):
            check(plan.strike, start, period, ACCELERATION, JERK)


@given(
    change=st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6).filter(lambda c: max(map(abs, c)) > 0.01),
    share=st.floats(0.0, 1.0),
    period=st.sampled_from(PERIODS),
    acceleration=st.floats(3.0, 15.0),
    jerk=st.floats(100.0, 2000.0),
)
@example(change=[0.0, 0.0, 0.0, 0.0, 0.0, 1.1875], share=0.171875, period=1 / 500, acceleration=12.0, jerk=100.0)
@settings(examples(20), report_multiple_bugs=False)
def test_any_move_is_stopped_within_any_limits_that_it_keeps_itself(
    change: list[float], share: float, period: float, acceleration: float, jerk: float
) -> None:
    full = np.ones(6)
    with mock.patch.object(timing, "SAMPLE_PERIOD", FINE):
        move = joint_move(np.zeros(6), np.array(change), 2.0 * full, 0.95 * acceleration * full, 0.6 * jerk * full)
    check(move, share * move.duration, period, acceleration, jerk)


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
    assert np.abs(np.diff(q, 2, axis=0)).max() <= 1.02 * 20.0 * period**2
    assert np.abs(np.diff(q, 3, axis=0)).max() <= 1.02 * 2000.0 * period**3


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
    """Duration [s] of the fastest stop whose joints keep the limits, on a grid of `step` [s]: linear programmes for
    the clock's jerk, linearised until they hold, for one step less and one less until none is feasible."""
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


@pytest.mark.parametrize("share", [0.3, 0.7, 1.0, 1.2])
def test_no_stop_is_two_cycles_slower_than_the_fastest_one(plans: list[StrikePlan], share: float) -> None:
    """Two cycles of the faster controller: from the middle of the run-up, still accelerating, to behind the contact."""
    for plan in plans[:2]:
        start = share * plan.contact_time
        ours = check(plan.strike, start, 1 / 500, ACCELERATION, JERK)
        best = fastest(plan.strike, start, ours, 0.002)
        assert best <= ours + 1e-9
        assert ours - best <= 2 / 500 + 1e-9
        coarse = check(plan.strike, start, 1 / 125, ACCELERATION, JERK)
        assert coarse - best <= 2 / 125 + 1e-9
