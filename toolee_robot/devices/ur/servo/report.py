"""The arm's state and motion reports from the shared memory, and the errors for the causes of a motion's end."""

from __future__ import annotations

import numpy as np

from toolee_robot.devices.ur.servo.messages import Cause
from toolee_robot.devices.ur.servo.program_watch import NOT_ENDED
from toolee_robot.devices.ur.servo.shared_memory import Column, ServoMemory, StateColumn, Word
from toolee_robot.devices.ur.status import ErrorLog, advice, arm_status, explain
from toolee_robot.errors import (
    EmergencyStopError,
    LinkLostError,
    MotionFaultError,
    OverrunError,
    ProtectiveStopError,
    TrackingError,
)
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, ArmStatus, MotionOutcome, MotionReport
from toolee_robot.types import JointState

RATIO_LIMIT = 1.0
"""Ratio at which the controller makes a protective stop."""
_OUTCOME = {Cause.NONE: MotionOutcome.COMPLETED, Cause.CONTACT: MotionOutcome.CONTACT}


def arm_state(state: Array, errors: ErrorLog | None = None) -> ArmState:
    """Convert a state of the shared memory.

    Args:
        state: The state, (StateColumn.COUNT,).
        errors: What the controller has said since the last motion began; None where nobody has listened.

    Returns:
        The state.
    """
    stamp = float(state[StateColumn.SEEN])
    deviation, collision = (None if np.isnan(ratio) else float(ratio) for ratio in state[StateColumn.RATIOS])
    return ArmState(
        joints=JointState(state[StateColumn.Q], state[StateColumn.QD], stamp),
        q_commanded=state[StateColumn.COMMANDED],
        wrench=state[StateColumn.WRENCH],
        status=arm_status(int(state[StateColumn.SAFETY_BITS]), int(state[StateColumn.ROBOT_MODE])),
        position_deviation_ratio=deviation,
        collision_ratio=collision,
        digital_inputs=int(state[StateColumn.DIGITAL_INPUTS]),
        safety_bits=int(state[StateColumn.SAFETY_BITS]),
        error_code=None if errors is None or (told := errors.told()) is None else told.name,
    )


def build_report(memory: ServoMemory, cause: Cause) -> MotionReport:
    """Report on the last motion.

    Args:
        memory: Shared memory with the motion's log, which is copied.
        cause: Why the motion ended.

    Returns:
        The report; its stamps are the times of sending.
    """
    rows = memory.rows[: int(memory.words[Word.ROWS])].copy()
    contact_row = int(memory.words[Word.CONTACT_ROW])
    contact = None
    if cause is Cause.CONTACT and 0 <= contact_row < len(rows):
        row = rows[contact_row]
        contact = JointState(row[Column.Q], row[Column.QD], float(row[Column.SEEN]))
    deviations, collisions = (None if np.isnan(ratios).any() else ratios for ratios in rows[:, Column.RATIOS].T)
    torques, currents = (_reported(drives) for drives in np.split(rows[:, Column.DRIVES], 2, axis=1))
    return MotionReport(
        outcome=_OUTCOME.get(cause, MotionOutcome.STOPPED),
        stamps=rows[:, Column.SENT],
        q_commanded=rows[:, Column.COMMANDED],
        q_measured=rows[:, Column.Q],
        wrenches=rows[:, Column.WRENCH],
        contact=contact,
        overruns=int(memory.words[Word.OVERRUNS]),
        position_deviation_ratios=deviations,
        collision_ratios=collisions,
        commands=min(int(memory.words[Word.COMMANDS]), len(rows)),
        lateness=float(rows[:, Column.LATENESS].max(initial=0.0)),
        data_age=float((rows[:, Column.SENT] - rows[:, Column.SEEN]).max(initial=0.0)),
        qd_measured=rows[:, Column.QD],
        torques=torques,
        currents=currents,
        safety_bits=rows[:, Column.SAFETY_BITS].astype(np.int64),
    )


def _reported(drives: Array) -> Array | None:
    """Torques or currents of a motion, (N, 6), if they are any.

    A motor that holds an arm has a current: zeros in all rows are those of a controller that has none to report, such
    as the stand-in.
    """
    known = drives[np.isfinite(drives).all(axis=1)]  # a reading that was lost does not cost the others
    return drives if known.any() else None


STOPPED_BEFORE = "the robot had stopped itself and is ready again, as after a safeguard door. Find out why, then reset"
"""What is told of a stop at rest whose reason nobody has seen in time."""


def fault(
    cause: Cause,
    state: ArmState,
    report: MotionReport | None,
    errors: ErrorLog | None = None,
    *,
    program_ended: bool = True,
) -> MotionFaultError:
    """The error for a motion that ended with a fault.

    Args:
        cause: Why the motion ended; `Cause.DATA` or more severe.
        state: Latest state of the robot.
        report: What was done until then; None for a fault at rest.
        errors: What the controller has said since the motion began; None where nobody has listened.
        program_ended: Whether the robot's program is known to have ended, after a lost link.

    Returns:
        The error to raise.
    """
    if cause is Cause.STOPPED_BY_ROBOT:
        status = state.status
        if status is ArmStatus.PROTECTIVE_STOP:
            return _protective_stop(state, report, errors)
        if status in (ArmStatus.EMERGENCY_STOP, ArmStatus.SAFEGUARD_STOP):
            return EmergencyStopError(advice(status), report)
        message = STOPPED_BEFORE if status is ArmStatus.READY else advice(status)
        if status is ArmStatus.FAULT and errors is not None and (told := errors.reason()) is not None:
            message += f". Its code is {explain(told)[0]}"
        return MotionFaultError(message, report)
    if cause is Cause.DATA:
        old = "" if report is None else f" (up to {report.data_age * 1e3:.0f} ms old)"
        message = f"the robot's data were late or implausible{old}, and the arm was stopped"
        return LinkLostError(f"{message}: check the network, then reset", report, code="link_lost.data")
    if cause is Cause.LINK:
        message = "the link to the robot is lost; its watchdog stops it: check the network, then reset"
        if not program_ended:
            message += f"; {NOT_ENDED}"
        return LinkLostError(message, report)
    if cause is Cause.SPEED_SLIDER:
        message = "the speed slider was moved and the arm was stopped: set it to 100 % at the pendant, then reset"
        return MotionFaultError(message, report, code="motion_fault.speed_slider")
    if cause is Cause.SPEED_SCALING:
        message = (
            "the controller slowed the motion down and the arm was stopped: look in the robot's log for the limit that "
            "it reached, then reset"
        )
        return MotionFaultError(message, report, code="motion_fault.speed_scaling")
    if cause is Cause.PROGRAM_PAUSED:
        message = "the robot's program was paused at the robot and has been ended: see why, then reset"
        return MotionFaultError(message, report)
    if cause is Cause.TRACKING:
        return TrackingError("the arm did not follow its commands and was stopped: look for an obstacle", report)
    if cause is Cause.OVERRUN:
        late = "" if report is None else f", by up to {report.lateness * 1e3:.0f} ms,"
        message = f"commands were sent late{late} and the arm was stopped: reduce the load on this machine"
        return OverrunError(message, report)
    if cause is Cause.TASK_STALLED:
        message = "the task's process stood still and the arm was stopped: close other programs, then try again"
        return MotionFaultError(message, report, code="motion_fault.task_stalled")
    return MotionFaultError(
        "the robot's program has ended (the pendant, its watchdog, another program): see the robot's log, then reset",
        report,
    )


def _protective_stop(state: ArmState, report: MotionReport | None, errors: ErrorLog | None) -> ProtectiveStopError:
    """The error for a protective stop, which names the reason where the controller's code or a ratio tells it."""
    message = advice(ArmStatus.PROTECTIVE_STOP)
    told = None if errors is None else errors.reason()
    kind = ""
    if told is not None:
        clause, kind = explain(told)
        message += f". Its code is {clause}"
    elif errors is not None:
        message += f". The controller's code is not known: {errors.why_empty}"
    deviation = _largest(state.position_deviation_ratio, None if report is None else report.position_deviation_ratios)
    collision = _largest(state.collision_ratio, None if report is None else report.collision_ratios)
    if told is None and max(deviation, collision) >= RATIO_LIMIT:
        if deviation >= collision:
            message += (
                f". Its joints were off their path (position deviation ratio {deviation:.2f}, it stops at 1). It "
                "was hit, or the motion was too fast for the payload that is set"
            )
            kind = "position_deviation"
        else:
            message += f". It detected a collision (collision detection ratio {collision:.2f}, a stop at 1)"
            kind = "collision"
    return ProtectiveStopError(message, report, code=f"protective_stop.{kind}" if kind else None)


def _largest(now: float | None, before: Array | None) -> float:
    """The largest of a ratio now and in a motion; 0 where it is unknown."""
    return max(0.0 if now is None else now, 0.0 if before is None or not len(before) else float(before.max()))
