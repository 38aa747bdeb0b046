"""Whether the tool that a station file describes lies within the cylinders that stand for it in collision checks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from toolee_robot.errors import ConfigError
from toolee_robot.frames import inverse

if TYPE_CHECKING:
    from toolee_robot.station.station import StationConfig


def check_enclosed(config: StationConfig, path: Path) -> None:
    """Refuse a tool whose handle, where the hand holds it, is outside of the handle's cylinder of `tool_envelope`.

    Args:
        config: The station, or a job on it.
        path: The file that describes the tool, for the message.

    Raises:
        ConfigError: The cylinders are another tool's. A tool whose face nobody has measured passes: the camera tells
            where it is, and the cylinders are widened until then.
    """
    tool, envelope = config.tool, config.tool_envelope
    if tool is None or (X_tool_face := tool.X_tool_face) is None:
        return
    along, across, behind = inverse(X_tool_face)[:3, 3]  # of the hand's place, in the frame of `ToolEnvelope`
    beside = float(np.hypot(across, behind + envelope.handle_depth)) + (tool.grip_radius or 0.0)
    if beside <= envelope.handle_radius and along <= envelope.handle_length:
        return
    raise ConfigError(
        f"{path}: where the hand holds it the handle of the {tool.name} is {1e3 * along:.0f} mm from the face and "
        f"reaches {1e3 * beside:.0f} mm from the axis of the handle's cylinder, which is "
        f"{1e3 * envelope.handle_length:.0f} mm long and has a radius of {1e3 * envelope.handle_radius:.0f} mm "
        f"(tool_envelope.handle_length, handle_radius, handle_depth {envelope.handle_depth:g}): collisions would be "
        "checked with another tool's shape. Give `tool_envelope` as measured of this one, or correct `tool.face`",
        code="config.tool_envelope",
    )
