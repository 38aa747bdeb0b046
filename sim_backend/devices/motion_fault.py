"""The faults that end a motion of the simulated arm."""

from __future__ import annotations

import numpy as np

from toolee_robot.errors import (
    EmergencyStopError,
    LinkLostError,
    MotionFaultError,
    OverrunError,
    ProtectiveStopError,
    TrackingError,
)
from toolee_robot.hal import ArmStatus, MotionWatch
from toolee_robot.sim_backend.devices.motion_log import MotionLog
from toolee_robot.sim_backend.ur_controller.robot.safety.error_codes import ErrorCode

# Class and message of the error.
Fault = tuple[type[MotionFaultError], str]


def motion_fault(
    status: ArmStatus, age: float, watch: MotionWatch, log: MotionLog, found: ErrorCode | None = None
) -> Fault | None:
    """The fault that must end the motion now, if any.

    Args:
        status: State of the robot's safety system.
        age: Age of the newest state [s].
        watch: Bounds of the motion.
        log: The motion so far.
        found: The error for which the robot has stopped itself, where it has.

    Returns:
        Class and message of the error; None without a fault.
    """
    if status is ArmStatus.EMERGENCY_STOP:
        return EmergencyStopError, "the emergency stop was pressed: release it at the robot"
    if status is ArmStatus.PROTECTIVE_STOP and found is not None:
        return ProtectiveStopError, f"the robot made a protective stop: {found}: find out why, release it at the robot"
    if status is not ArmStatus.READY:
        return ProtectiveStopError, f"the robot stopped itself ({status}): find out why, release it at the robot"
    if age > watch.data_cycles / log.rate + 1e-9:
        return LinkLostError, f"no data from the arm for {age * 1e3:.0f} ms: check its network link"
    # An old reading says nothing about the current tracking error.
    error = np.abs(log.measured[-1] - log.commanded[-1]) if age == 0.0 else np.zeros(6)
    if error.max() > watch.tracking_error:
        joint = int(error.argmax())
        return TrackingError, f"joint {joint + 1} is {error[joint]:.3f} rad away from its command"
    if log.late_in_a_row > watch.overruns:
        return OverrunError, f"{log.late_in_a_row} commands in a row were sent late: reduce the load on this machine"
    return None
