"""The project's errors: one root, each message says what happened and what to do about it.

`UserError` is the caller's fault (a bad option, an unreadable file): the command line exits with 2.
Every other `TooleeError` is a job that failed: the command line exits with 1.
"""

from __future__ import annotations


class TooleeError(Exception):
    """Root of every error this project raises on purpose."""


class UserError(TooleeError):
    """The input is unusable; the message says what to change."""


class ConfigError(UserError):
    """A configuration file or value is invalid."""


class FrameMismatchError(TooleeError):
    """Two poses were composed whose inner frames differ."""


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


class GripError(DeviceError):
    """The hand does not hold the tool (any more)."""
