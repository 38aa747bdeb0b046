"""The supervisor's person, faults and contacts: it stops, latches, and judges where the face met something."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.control.desk import GUARD, Desk, refused
from tests.errors import raises
from toolee_robot.control import (
    Meeting,
    Mode,
    StrikePlan,
)
from toolee_robot.errors import (
    DeviceError,
    EmergencyStopError,
    LatchedError,
    LimitError,
    LinkLostError,
    MotionFaultError,
    OverrunError,
    PersonNearError,
    ProtectiveStopError,
    TrackingError,
)
from toolee_robot.hal import ArmStatus, MotionOutcome

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
    assert desk.person.asked == 2, "asked once for all strikes"
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
        (1.03, Meeting.EXPECTED),
        (1.2, Meeting.LATE),
        (None, Meeting.NONE),
    ],
)
def test_a_contact_is_judged_by_its_place(desk: Desk, plan: StrikePlan, share: float | None, meeting: Meeting) -> None:
    """1.2 m/s for 0.33 s: a share of 0.01 is some 4 mm."""
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
