"""The project's errors: one root; each message says what happened and what to do about it.

`UserError` is the caller's fault (a bad option, an unreadable file): the command line exits with 2.
Every other `TooleeError` is a job that failed: the command line exits with 1.

Every error has a `code` for programs and tests. It is the class's own (`unreachable` of an `UnreachableError`), or more
specific where one class has several causes: `raise LimitError(message, code="limit.speed")`. Codes are stable;
messages are for people and may change.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from toolee_robot.hal import MotionReport


class TooleeError(Exception):
    """Root of every error this project raises on purpose.

    Attributes:
        code: Stable identifier of the cause: lower-case words joined by `_`, from the general to the specific joined by
            `.`; the class's name without "Error" unless the place that raises it says more.
    """

    code: str = "toolee"

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "code" not in cls.__dict__:
            cls.code = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__.removesuffix("Error")).lower()

    def __init__(self, message: str = "", *, code: str | None = None) -> None:
        """
        Args:
            message: What happened, and what to do about it.
            code: The cause, where it is more specific than the class.
        """
        super().__init__(message)
        if code is not None:
            self.code = code


class UserError(TooleeError):
    """The input is unusable; the message says what to change."""


class ConfigError(UserError):
    """A configuration file or value is invalid."""


class AssetError(TooleeError):
    """A robot model, mesh or weight file is missing or unreadable."""


class PerceptionError(TooleeError):
    """The tool could not be found or its pose not be trusted."""


class PlanningError(TooleeError):
    """No safe motion exists for what was asked; nothing was moved."""


class UnreachableError(PlanningError):
    """Inverse kinematics found no configuration."""


class CollisionError(PlanningError):
    """Every candidate motion would collide; names the closest pair."""


class LimitError(PlanningError):
    """A trajectory breaks a position, velocity or acceleration limit, or is not finite."""


class DeviceError(TooleeError):
    """A device (arm, hand, camera) failed or does not answer. The arm has been told to stop."""


class StaleDataError(DeviceError):
    """The newest reading is older than the caller allows."""


class NoAnswerError(DeviceError):
    """A device cannot be reached, is silent, or closed the connection."""


class ProtocolError(DeviceError):
    """A device sent what its protocol does not allow: it is another device, or another version of it."""


class GripError(DeviceError):
    """The hand does not hold the tool (any more)."""


class NotReadyError(DeviceError):
    """A check before any motion failed: wrong robot, model, payload, version or mode. Nothing was moved."""


class LatchedError(DeviceError):
    """A fault has stopped the arm and nobody has reset it yet; names the fault. Nothing was moved."""


class MotionFaultError(DeviceError):
    """A fault ended a motion; the arm stands still and is latched. report: what was done until then, or None."""

    def __init__(self, message: str = "", report: MotionReport | None = None, *, code: str | None = None) -> None:
        """
        Args:
            message: What happened, and what to do about it.
            report: What was done until then; None where nothing was moved.
            code: The cause, where it is more specific than the class.
        """
        super().__init__(message, code=code)
        self.report = report


class PersonNearError(MotionFaultError):
    """A person is or may be where they must not be, or has not confirmed what only a person can. report: None where
    nothing was moved."""


class TrackingError(MotionFaultError):
    """The arm did not follow its commands."""


class LinkLostError(MotionFaultError, StaleDataError):
    """The arm's data stopped coming; the robot's own watchdog stops it."""


class OverrunError(MotionFaultError):
    """Commands could not be sent on time."""


class ProtectiveStopError(MotionFaultError):
    """The robot stopped itself; a person must look why and release it at the robot."""


class EmergencyStopError(MotionFaultError):
    """The emergency or safeguard stop is pressed; no queued command survives it."""


class ServoCrashError(MotionFaultError):
    """The process that talks to the arm died or hangs."""
