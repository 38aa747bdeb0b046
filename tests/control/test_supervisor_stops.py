"""The supervisor's person, faults and contacts: it stops, latches, and judges where the face met something."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, event, example, given, settings
from hypothesis import strategies as st

from tests.control.desk import GUARD, Desk, refused
from tests.control.paper_arm import STOP_ACCELERATION, STOP_JERK, Bystander, PaperArm
from tests.errors import raises
from tests.examples import examples
from toolee_robot.control import (
    CollisionWorld,
    Meeting,
    Mode,
    RobotModel,
    StrikePlan,
    Supervisor,
    slowed_to,
)
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.control.supervisor_checks import Watcher
from toolee_robot.errors import (
    DeviceError,
    EmergencyStopError,
    LatchedError,
    LimitError,
    LinkLostError,
    MotionFaultError,
    OverrunError,
    PersonNearError,
    PlanningError,
    ProtectiveStopError,
    TrackingError,
)
from toolee_robot.frames import Array
from toolee_robot.hal import ArmStatus, MotionOutcome
from toolee_robot.station import StationConfig
from toolee_robot.types import Trajectory

# -- people ------------------------------------------------------------------------------------------------------


def test_no_swing_without_a_mode_a_confirmation_and_a_plan(desk: Desk, plan: StrikePlan) -> None:
    def swing() -> object:
        return desk.supervisor.swing(plan.strike, GUARD, plan.expected_contact)

    desk.arm.q = plan.strike.q[0].copy()
    refused(desk, LimitError, swing, "limit.speed")
    desk.supervisor.mode = Mode.UNATTENDED
    refused(desk, PersonNearError, swing, "person_near.swing_not_permitted")
    desk.person.confirms = False
    refused(desk, PersonNearError, lambda: desk.supervisor.permit_swings(1.0), "person_near.swing_not_confirmed")
    refused(desk, PersonNearError, swing, "person_near.swing_not_permitted")
    desk.person.confirms = True
    desk.supervisor.permit_swings(1.0)
    desk.person.here = True
    refused(desk, PersonNearError, swing, "person_near.before_motion")
    desk.person.here = False
    late = replace(plan.expected_contact, time=9.0)
    refused(desk, LimitError, lambda: desk.supervisor.swing(plan.strike, GUARD, late), "limit.contact_time")
    swing()
    assert desk.person.asked == ["swing"] * 2, "asked once for all strikes"
    desk.supervisor.mode = Mode.UNATTENDED
    desk.arm.q = plan.strike.q[0].copy()
    desk.supervisor.reset(confirmed=True)
    desk.supervisor.mode = Mode.UNATTENDED
    refused(desk, PersonNearError, swing, "person_near.swing_not_permitted")


def test_nobody_hammers_while_somebody_is_inside(desk: Desk) -> None:
    desk.person.here = True
    with raises(PersonNearError, code="person_near.zone_occupied"):
        desk.supervisor.mode = Mode.UNATTENDED
    assert desk.supervisor.mode is Mode.HANDOVER
    desk.supervisor.execute(desk.slow())  # slowly it may


def test_somebody_steps_in_during_a_swing(desk: Desk, plan: StrikePlan) -> None:
    desk.ready_to_swing(plan)
    desk.arm.pause = 0.005

    def step_in() -> None:
        desk.person.here = desk.person.here or len(desk.arm.driven) >= 10

    desk.arm.tick = step_in
    with raises(PersonNearError, code="person_near.during_motion") as caught:
        desk.supervisor.swing(plan.strike, GUARD, plan.expected_contact)
    report = caught.value.report
    assert report is not None
    assert report.outcome is MotionOutcome.STOPPED
    assert len(report.stamps) < 10 + 25, "asked every 10 ms, and braking takes 0.16 s at most"
    np.testing.assert_allclose(desk.arm.q, report.q_commanded[-1])
    desk.person.here = False
    refused(desk, LatchedError, lambda: desk.supervisor.execute(desk.slow()), "latched")


def test_the_hold_to_run_switch_stops_a_slow_motion_and_does_not_latch(desk: Desk) -> None:
    desk.person.holds = False
    refused(desk, PersonNearError, lambda: desk.supervisor.execute(desk.slow()), "person_near.before_motion")
    desk.person.holds = True
    desk.arm.pause = 0.002

    def let_go() -> None:
        desk.person.holds = len(desk.arm.driven) < 20

    desk.arm.tick = let_go
    move = desk.slow(0.5)
    with raises(PersonNearError, code="person_near.during_motion"):
        desk.supervisor.execute(move)
    assert np.abs(desk.arm.q - move.q[-1]).max() > 0.1
    assert not desk.supervisor.latched
    desk.arm.tick, desk.person.holds = lambda: None, True
    desk.supervisor.execute(desk.slow(0.1))


@pytest.mark.parametrize(("mode", "assumed"), [(Mode.UNATTENDED, "may be within"), (Mode.HANDOVER, "nobody is known")])
def test_what_is_assumed_for_want_of_a_reading_is_not_told_as_seen(desk: Desk, mode: Mode, assumed: str) -> None:
    desk.supervisor.mode = mode
    desk.person.late = True
    with raises(PersonNearError, code="person_near.before_motion") as caught:
        desk.supervisor.execute(desk.slow())
    assert assumed in str(caught.value)
    assert "are late" in str(caught.value)
    desk.person.late, desk.person.here, desk.person.holds = False, True, False
    with raises(PersonNearError, code="person_near.before_motion") as caught:
        desk.supervisor.execute(desk.slow())
    assert "late" not in str(caught.value)


def test_a_person_sensor_that_fails_stops_the_arm(desk: Desk) -> None:
    desk.arm.pause = 0.002
    calls: list[int] = []

    def broken() -> bool:
        calls.append(1)
        if len(calls) > 2:
            raise OSError("scanner unplugged")
        return True

    desk.person.hold_to_run_held = broken  # type: ignore[method-assign]
    with pytest.raises(PersonNearError, match="scanner unplugged"):
        desk.supervisor.execute(desk.slow(0.5))


# -- faults --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "fault", [TrackingError, LinkLostError, OverrunError, ProtectiveStopError, EmergencyStopError, MotionFaultError]
)
def test_a_fault_latches_until_a_person_resets(desk: Desk, fault: type[MotionFaultError]) -> None:
    desk.arm.fault = fault
    with pytest.raises(fault):
        desk.supervisor.execute(desk.slow())
    desk.arm.fault = None
    stood = desk.arm.q.copy()
    refused(desk, LatchedError, lambda: desk.supervisor.execute(desk.slow()), "latched")
    with raises(DeviceError, code="device.reset_not_confirmed"):
        desk.supervisor.reset()
    assert desk.arm.resets == 0, "never by itself"
    desk.arm.status = ArmStatus.PROTECTIVE_STOP
    with pytest.raises(DeviceError, match="not ready"):
        desk.supervisor.reset(confirmed=True)
    refused(desk, LatchedError, lambda: desk.supervisor.execute(desk.slow()), "latched")
    desk.arm.status = ArmStatus.READY
    desk.supervisor.reset(confirmed=True)
    assert desk.supervisor.mode is Mode.HANDOVER
    np.testing.assert_array_equal(desk.arm.q, stood)
    desk.supervisor.execute(desk.slow())


# -- contact -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("share", "meeting"),
    [
        (0.7, Meeting.EARLY),
        (0.9, Meeting.EARLY),
        (0.985, Meeting.EXPECTED),
        (1.01, Meeting.EXPECTED),
        (1.1, Meeting.LATE),
        (None, Meeting.NONE),
    ],
)
def test_a_contact_is_judged_by_its_place(desk: Desk, plan: StrikePlan, share: float | None, meeting: Meeting) -> None:
    """0.9 m/s for 0.33 s: a share of 0.01 is some 3 mm. No strike goes deeper than 20 mm; here beyond 8 mm is late."""
    supervisor = replace(desk.config.supervisor, late_contact=0.008)
    desk.supervisor = Supervisor(
        desk.arm, desk.person, desk.world.robot, replace(desk.config, supervisor=supervisor), lambda: desk.world
    )
    desk.ready_to_swing(plan)
    desk.arm.meets = None if share is None else share * plan.contact_time / plan.strike.duration
    _, verdict = desk.supervisor.swing(plan.strike, GUARD, plan.expected_contact)
    assert verdict.meeting is meeting
    assert not desk.supervisor.latched, "a strike beside the nail is no fault of the arm"


def test_a_servo_lag_is_no_early_contact(desk: Desk, plan: StrikePlan) -> None:
    """A contact that is felt 60 ms after the command passed the place, with the joints only just there."""
    desk.ready_to_swing(plan)
    desk.arm.lag = 0.06
    desk.arm.meets = (plan.contact_time + desk.arm.lag) / plan.strike.duration
    _, verdict = desk.supervisor.swing(plan.strike, GUARD, plan.expected_contact)
    assert verdict.meeting is Meeting.EXPECTED
    assert abs(verdict.before) < 0.011


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
    assert np.abs(np.diff(q, 2, axis=0)).max() * rate**2 <= 1.05 * max(*limits.acceleration, STOP_ACCELERATION)
    assert np.abs(np.diff(q, 3, axis=0)).max() * rate**3 <= 1.05 * max(limits.jerk, STOP_JERK)
    p = robot.arm.fk(q)[:, :3, 3]
    assert np.all(
        (p > np.array(config.scene.workspace_lower) - 1e-3) & (p < np.array(config.scene.workspace_upper) + 1e-3)
    )
    fastest = np.linalg.norm(np.diff(p, axis=0), axis=1).max() * rate
    assert fastest <= 1.02 * mode.speed(config.supervisor)
    assert world.closest(q, 1e-4).distance > 0.0


def test_a_stop_that_comes_too_soon_is_repeated() -> None:
    """An arm that has not begun to move when it is told to stop would set off: it is told again, until it is over."""
    told: list[int] = []
    begun, stopped = threading.Event(), threading.Event()

    def stop() -> None:
        told.append(1)
        if begun.is_set():
            stopped.set()
        elif len(told) == 2:
            begun.set()

    with Watcher(lambda: "somebody is near", stop, "nobody can tell") as watcher:
        assert stopped.wait(10.0)
    assert watcher.reason == "somebody is near"
    count = len(told)
    assert not threading.Event().wait(0.05)
    assert len(told) == count, "it is over"
