"""What the servo process left in the shared memory, as a report, and the error that a cause of an end becomes."""

from __future__ import annotations

from toolee_robot.errors import (
    EmergencyStopError,
    LinkLostError,
    MotionFaultError,
    OverrunError,
    ProtectiveStopError,
    TrackingError,
)
from toolee_robot.hal import ArmStatus, MotionOutcome, MotionReport
from toolee_robot.hardware.ur.servo.messages import Cause
from toolee_robot.hardware.ur.servo.shared_memory import Column, ServoMemory, Word
from toolee_robot.hardware.ur.status import advice
from toolee_robot.types import JointState

_OUTCOME = {Cause.NONE: MotionOutcome.COMPLETED, Cause.CONTACT: MotionOutcome.CONTACT}


def build_report(memory: ServoMemory, cause: Cause) -> MotionReport:
    """Of the motion that ended last, with copies of all that was sent and measured; stamps are of sending."""
    rows = memory.rows[: int(memory.words[Word.ROWS])].copy()
    touched = int(memory.words[Word.CONTACT_ROW])
    contact = None
    if cause is Cause.CONTACT and 0 <= touched < len(rows):
        row = rows[touched]
        contact = JointState(row[Column.Q], row[Column.QD], float(row[Column.SEEN]))
    return MotionReport(
        outcome=_OUTCOME.get(cause, MotionOutcome.STOPPED),
        stamps=rows[:, Column.SENT],
        q_commanded=rows[:, Column.COMMANDED],
        q_measured=rows[:, Column.Q],
        wrenches=rows[:, Column.WRENCH],
        contact=contact,
        overruns=int(memory.words[Word.OVERRUNS]),
    )


def fault(cause: Cause, status: ArmStatus, report: MotionReport | None) -> MotionFaultError:
    """cause: from `Cause.DATA` on. status: what the robot's safety system said last."""
    if cause is Cause.STOPPED_BY_ROBOT:
        if status is ArmStatus.PROTECTIVE_STOP:
            return ProtectiveStopError(advice(status), report)
        if status in (ArmStatus.EMERGENCY_STOP, ArmStatus.SAFEGUARD_STOP):
            return EmergencyStopError(advice(status), report)
        # It may be ready again by now; that it was not is what counts.
        status = status if status is not ArmStatus.READY else ArmStatus.NOT_READY
        return MotionFaultError(advice(status), report)
    if cause is Cause.DATA:
        return LinkLostError(
            "the robot's data came late or made no sense, and the arm was stopped: check the network, reset", report
        )
    if cause is Cause.LINK:
        return LinkLostError("the link to the robot is lost; its watchdog stops it: check the network, reset", report)
    if cause is Cause.TRACKING:
        return TrackingError("the arm did not follow its commands, and was stopped: look what is in its way", report)
    if cause is Cause.OVERRUN:
        return OverrunError("commands went out late, and the arm was stopped: take load off this machine", report)
    if cause is Cause.TASK_STALLED:
        return MotionFaultError("the task's process stood still, and the arm was stopped: see what held it up", report)
    return MotionFaultError(
        "the robot's program has ended (the pendant, its watchdog, another program): see the robot's log, then reset",
        report,
    )
