"""Hundreds of spoiled motions and faults in random combinations: what the arm was driven through breaks no limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, event, example, given, settings
from hypothesis import strategies as st

from tests.control.paper_arm import STOP_ACCELERATION, STOP_JERK, Bystander, PaperArm
from tests.examples import examples
from toolee_robot.control import CollisionWorld, Mode, RobotModel, Supervisor, slowed_to
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.errors import DeviceError, EmergencyStopError, PlanningError, ProtectiveStopError, TrackingError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmStatus
from toolee_robot.station import StationConfig
from toolee_robot.types import Trajectory

VALUES = st.one_of(
    st.floats(-1e-4, 1e-4),
    st.floats(-0.05, 0.05),
    st.floats(-4.0, 4.0),
    st.sampled_from([np.nan, np.inf, -np.inf, 1e9]),
)

# A first motion that starts beside where the arm is commanded, which follows exactly and jumps there in one cycle.
BESIDE = {
    "goal": [0.0] * 6,
    "slowed": False,
    "speed": 1.0,
    "acceleration": 8.0,
    "jerk": 300.0,
    "mode": Mode.HANDOVER,
    "inside": False,
    "absent": False,
    "status": ArmStatus.READY,
    "off": 0.0,
    "fault": None,
    "again": False,
}

# One that would stand for thirty years before its end, and be sampled at the arm's rate all the while.
FOR_YEARS = BESIDE | {"mode": Mode.UNATTENDED}

RARELY = st.sampled_from([False] * 5 + [True])


@st.composite
def spoiled(draw: st.DrawFn) -> list[tuple[str, float, int, bool, float]]:
    """Up to three changes: which array, from which share of it, which joint, to its end or one sample, by how much."""
    change = st.tuples(
        st.sampled_from(["q", "qd", "qdd", "times"]), st.floats(0.0, 1.0), st.integers(0, 5), st.booleans(), VALUES
    )
    return draw(st.lists(change, max_size=3))


def apply(move: Trajectory, changes: list[tuple[str, float, int, bool, float]]) -> Trajectory | None:
    for name, share, joint, to_end, value in changes:
        x = getattr(move, name).copy()
        row = min(int(share * len(x)), len(x) - 1)
        rows = slice(row, None) if to_end else slice(row, row + 1)
        if name == "times":
            x[rows] += value
        else:
            x[rows, joint] += value
        try:
            move = replace(move, **{name: x})
        except ValueError:  # times that do not increase are no trajectory
            return None
    return move


@pytest.fixture(scope="module")
def free(robot: RobotModel, config: StationConfig, q_hand: Array, X_hand_ee: Array) -> CollisionWorld:
    return CollisionWorld(robot, config, q_hand, X_hand_ee)


@given(
    goal=st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6),
    slowed=st.booleans(),
    speed=st.floats(0.05, 2.5),
    acceleration=st.floats(0.5, 16.0),
    jerk=st.floats(5.0, 550.0),
    changes=st.one_of(st.just([]), st.just([]), spoiled()),
    mode=st.sampled_from(list(Mode)),
    inside=RARELY,
    absent=RARELY,
    status=st.sampled_from([ArmStatus.READY] * 20 + list(ArmStatus)),
    off=st.sampled_from([0.0, 0.0, 0.0, 0.0, 0.001, 0.1]),
    fault=st.sampled_from([None, None, None, TrackingError, ProtectiveStopError, EmergencyStopError]),
    again=st.booleans(),
)
@example(**BESIDE, changes=[("q", 0.0, 0, True, 0.015625)])
@example(**BESIDE, changes=[("q", 0.0, 0, True, 0.009)])
@example(**FOR_YEARS, changes=[("times", 1.0, 0, True, 1e9)])
@settings(examples(100), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_nothing_that_is_driven_breaks_a_limit(
    robot: RobotModel,
    config: StationConfig,
    home: Array,
    free: CollisionWorld,
    goal: list[float],
    slowed: bool,
    speed: float,
    acceleration: float,
    jerk: float,
    changes: list[tuple[str, float, int, bool, float]],
    mode: Mode,
    inside: bool,
    absent: bool,
    status: ArmStatus,
    off: float,
    fault: type[TrackingError] | None,
    again: bool,
) -> None:
    arm, person = PaperArm(home), Bystander()
    supervisor = Supervisor(arm, person, robot, config, lambda: free)
    supervisor.mode = mode
    person.here, person.holds = inside, not absent
    arm.status, arm.fault = status, fault
    arm.measured_off = np.full(6, off)
    ones = np.ones(6)
    move = joint_move(home, home + np.array(goal), speed * ones, acceleration * ones, jerk * ones)
    if slowed:
        move = slowed_to(move, free, mode.speed(config.supervisor))
    spoilt = apply(move, changes)
    if spoilt is None:
        return
    for _ in range(1 + again):
        before, raised = len(arm.driven), None
        try:
            supervisor.execute(spoilt)
        except (PlanningError, DeviceError) as error:
            raised = error
        failed = fault is not None and isinstance(raised, fault)
        assert (len(arm.driven) > before) == (raised is None or failed), raised
        assert not (failed and before), "after a fault nothing moves again"
    if not arm.driven:
        return
    assert status is ArmStatus.READY
    assert off < 0.03
    assert not inside if mode is Mode.UNATTENDED else not absent
    event("driven")
    check_driven(np.array([home, home, home, *arm.driven, arm.driven[-1], arm.driven[-1]]), robot, config, free, mode)


def check_driven(q: Array, robot: RobotModel, config: StationConfig, world: CollisionWorld, mode: Mode) -> None:
    """Against the limits, by finite differences of what the arm went through, at its own rate."""
    limits, rate = config.arm, PaperArm.rate
    assert np.all(np.isfinite(q))
    assert np.all((q > robot.arm.lower - 0.02) & (q < robot.arm.upper + 0.02))
    assert np.all(np.abs(np.diff(q, axis=0)) * rate <= 1.02 * np.array(limits.velocity))
    assert np.abs(np.diff(q, 2, axis=0)).max() * rate**2 <= 1.05 * max(limits.acceleration, STOP_ACCELERATION)
    assert np.abs(np.diff(q, 3, axis=0)).max() * rate**3 <= 1.05 * max(limits.jerk, STOP_JERK)
    p = robot.arm.fk(q)[:, :3, 3]
    assert np.all(
        (p > np.array(config.scene.workspace_lower) - 1e-3) & (p < np.array(config.scene.workspace_upper) + 1e-3)
    )
    fastest = np.linalg.norm(np.diff(p, axis=0), axis=1).max() * rate
    assert fastest <= 1.02 * mode.speed(config.supervisor)
    assert world.closest(q, 1e-4).distance > 0.0
