"""Error classes of the project, with a common root; each message states what happened and what to do about it.

A `UserError` is caused by the caller's input (a bad option, an unreadable file); the command line exits with 2. Every
other `TooleeError` is a failed job; the command line exits with 1.

Every error has a `code` for programs and tests: that of its class (`unreachable` for an `UnreachableError`), or a more
specific one where a class has several causes: `raise LimitError(message, code="limit.speed")`. Codes are stable;
messages are for people and may change.
"""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from toolee_robot.hal import MotionReport


class TooleeError(Exception):
    """Root of the project's errors.

    Args:
        message: What happened, and what to do about it.
        code: The cause, where it is more specific than the class.

    Attributes:
        code: Stable identifier of the cause: lower-case words joined by `_`, from the general to the specific joined by
            `.`. The default is the class's name without "Error".
    """

    code: str = "toolee"

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "code" not in cls.__dict__:
            cls.code = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__.removesuffix("Error")).lower()

    def __init__(self, message: str = "", *, code: str | None = None) -> None:
        super().__init__(message)
        if code is not None:
            self.code = code


class UserError(TooleeError):
    """The input is unusable; the message states what to change."""


class ConfigError(UserError):
    """A configuration file or value is invalid."""


class AssetError(TooleeError):
    """A robot model, mesh or weight file is missing or unreadable."""


class PerceptionError(TooleeError):
    """The tool was not found, or its pose cannot be trusted."""


class WeighingError(TooleeError):
    """The arm cannot weigh the tool in its hand, or not well enough; the message says what to do instead."""


class PlanningError(TooleeError):
    """No safe motion exists for the request; nothing was moved."""


class UnreachableError(PlanningError):
    """Inverse kinematics has no solution."""


class CollisionError(PlanningError):
    """Every candidate motion would collide; the message names the closest pair of bodies."""


class LimitError(PlanningError):
    """A trajectory or payload violates a limit, or is not finite."""


class DeviceError(TooleeError):
    """A device (arm, hand, camera) failed or does not answer; the arm was commanded to stop."""


class StaleDataError(DeviceError):
    """The newest reading is older than the caller allows."""


class NoAnswerError(DeviceError):
    """A device cannot be reached, does not answer, or closed the connection."""


class ProtocolError(DeviceError):
    """A device violated its protocol: it is another device, or another version."""


class GripError(DeviceError):
    """The hand does not hold the tool."""


class GripDoubtError(DeviceError):
    """The hand reported for a moment that it does not hold the tool, and then that it does; the arm was stopped."""


class NotReadyError(DeviceError):
    """A check before the motion failed: robot, model, payload, version or mode; nothing was moved."""


class LatchedError(DeviceError):
    """An earlier fault, which the message names, has not been reset; nothing was moved."""


class MotionFaultError(DeviceError):
    """A fault ended a motion; the arm stands still and is latched.

    Args:
        message: What happened, and what to do about it.
        report: The motion until the fault; None where nothing was moved.
        code: The cause, where it is more specific than the class.

    Attributes:
        report: The motion until the fault; None where nothing was moved.
    """

    def __init__(self, message: str = "", report: MotionReport | None = None, *, code: str | None = None) -> None:
        super().__init__(message, code=code)
        self.report = report


class PersonNearError(MotionFaultError):
    """A person is or may be within reach, or has not given a required confirmation."""


class TrackingError(MotionFaultError):
    """The arm did not follow its commands."""


class LinkLostError(MotionFaultError, StaleDataError):
    """The arm's data stream stopped; the robot's own watchdog stops the arm."""


class OverrunError(MotionFaultError):
    """Commands were not sent on time."""


class ProtectiveStopError(MotionFaultError):
    """The robot stopped itself; a person must find the cause and release the stop at the robot."""


class EmergencyStopError(MotionFaultError):
    """The emergency or safeguard stop is pressed; no queued command survives it."""


class ServoCrashError(MotionFaultError):
    """The servo process died or hangs."""


def words_of(error: BaseException) -> str:
    """Put in words what went wrong, for a message that names the file, address or port itself.

    Args:
        error: An error of the operating system, in any of the forms in which libraries wrap it, or another one.

    Returns:
        The operating system's words without number and path, such as "No such file or directory"; of other errors
        their text, or their name where they have none.
    """
    if isinstance(error, KeyError) and error.args:
        return f"{error.args[0]!r} is missing"
    number, text, *_ = (*error.args, None, None)
    if isinstance(number, int) and isinstance(text, str):  # OSError, and termios.error, which is none
        text = getattr(error, "strerror", text)
        return os.strerror(number) if "[Errno" in text else text  # pyserial puts one error's text into the next one's
    return re.sub(r"\[Errno -?\d+\] ", "", str(error)) or type(error).__name__
