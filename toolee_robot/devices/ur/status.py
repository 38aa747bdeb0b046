"""Conversion of the controller's status numbers to `hal.ArmStatus`, and advice for each status."""

from __future__ import annotations

from toolee_robot.errors import NotReadyError
from toolee_robot.hal import ArmStatus

# RTDE's safety_status_bits.
_NORMAL_OR_REDUCED = 1 << 0 | 1 << 1
_PROTECTIVE_STOP = 1 << 2
_RECOVERY = 1 << 3
_SAFEGUARD_STOP = 1 << 4
_EMERGENCY_STOP = 1 << 5 | 1 << 6 | 1 << 7  # of the system, of the robot, of either
_FAULT = 1 << 8 | 1 << 9  # violation, fault
_STOPPED_FOR_SAFETY = 1 << 10

ROBOT_MODE_RUNNING = 7
RUNTIME_STOPPED, RUNTIME_PLAYING = 1, 2
RUNTIME_PAUSED = (3, 4, 5)
"""RTDE's runtime_state of a program that is pausing, paused, or being resumed."""
FULL_SPEED = 0.995
"""Fraction of the commanded speed from which on a motion counts as executed at it."""

_ADVICE = {
    ArmStatus.PROTECTIVE_STOP: "the robot has made a protective stop: look why, release it at the robot, then reset",
    ArmStatus.SAFEGUARD_STOP: "the safeguard stop is open: close it and reset it at the robot, then reset",
    ArmStatus.EMERGENCY_STOP: "the emergency stop is pressed: release it, switch the robot on again, then reset",
    ArmStatus.FAULT: "the robot reports a safety violation or fault: see its pendant, then reset",
    ArmStatus.NOT_READY: "the robot is not in its running mode: switch it on and release the brakes, then reset",
}


def arm_status(safety_bits: int, robot_mode: int) -> ArmStatus:
    """Convert RTDE's status numbers.

    Args:
        safety_bits: RTDE's safety_status_bits.
        robot_mode: RTDE's robot_mode.

    Returns:
        The most severe status that applies.
    """
    if safety_bits & _FAULT:
        return ArmStatus.FAULT
    if safety_bits & _EMERGENCY_STOP:
        return ArmStatus.EMERGENCY_STOP
    if safety_bits & _PROTECTIVE_STOP:
        return ArmStatus.PROTECTIVE_STOP
    if safety_bits & (_SAFEGUARD_STOP | _STOPPED_FOR_SAFETY):
        return ArmStatus.SAFEGUARD_STOP
    moves = safety_bits & _NORMAL_OR_REDUCED and not safety_bits & _RECOVERY
    if not moves or robot_mode != ROBOT_MODE_RUNNING:
        return ArmStatus.NOT_READY
    return ArmStatus.READY


def advice(status: ArmStatus) -> str:
    """What has happened and what a person must do, for every status but READY."""
    return _ADVICE[status]


def check_speed_slider(fraction: float) -> None:
    """Check that the speed slider is at its end, since motions are timed for it.

    Args:
        fraction: Position of the slider, 0 to 1.

    Raises:
        NotReadyError: It is not; code `not_ready.speed_slider`.
    """
    if not fraction >= FULL_SPEED:
        message = f"the speed slider is at {fraction:.0%}: set it to 100 % at the pendant, motions are timed for it"
        raise NotReadyError(message, code="not_ready.speed_slider")
