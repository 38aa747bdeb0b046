"""The tool that a person hands over, as its data sheet or a ruler and scales tell it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from toolee_robot.errors import ConfigError
from toolee_robot.frames import Array, frame_from_axes, inverse
from toolee_robot.station.values import STRICT
from toolee_robot.types.units import Direction, Kilograms, Metres, NearPoint

if TYPE_CHECKING:
    from toolee_robot.station.station import StationConfig


@dataclass(frozen=True)
class ToolData:
    """A hammer, measured. No field has a default: nobody but the lab knows its hammer.

    Its frame `tool`: origin on the handle's axis where the hand holds it, z along the handle towards the head, x to the
    side that strikes. How the tool really lies in the hand is what the camera finds out. What nobody has measured is
    null: then the arm weighs the tool in the hand, and the camera looks for a face of which nothing is known
    (docs/how-to/unknown_hammer.md).
    """

    __pydantic_config__ = STRICT
    name: str
    """What people call it."""
    grip_radius: Annotated[float, Metres(0.002, 0.1)] | None
    """Radius of the handle where the hand holds it; of an oval one the mean. Null: unknown."""
    face: NearPoint | None
    """Middle of the striking face in `tool`. Null, together with `face_normal`: unknown."""
    face_normal: Direction | None
    """Direction in which the face strikes, in `tool`; any length."""
    mass: Annotated[float, Kilograms(0.02, 4.0, "hammers for one hand")] | None
    """Mass of the whole tool. Null, together with `center_of_mass`: the arm weighs it."""
    center_of_mass: NearPoint | None
    """Centre of mass of the whole tool in `tool`."""

    def __post_init__(self) -> None:
        for one, other in (("face", "face_normal"), ("mass", "center_of_mass")):
            if (getattr(self, one) is None) != (getattr(self, other) is None):
                raise ValueError(f"{one} and {other} belong together: give both, or null for both")
        if self.face is None or self.face_normal is None:
            return
        normal = np.asarray(self.face_normal)
        if np.linalg.norm(normal[:2]) < 1e-6:
            raise ValueError("face_normal is no direction beside the handle: a hammer strikes to the side, such as x")
        x, y, z = self.face
        if z <= np.hypot(x, y):
            raise ValueError(
                f"face {list(self.face)} is not at the end of the handle, which is the z axis: x to the side that "
                "strikes, z along the handle towards the head"
            )

    @property
    def X_tool_face(self) -> Array | None:
        """Pose of the striking face, (4, 4): z is its normal, x points towards the handle's butt; None if unknown."""
        if self.face is None or self.face_normal is None:
            return None
        return frame_from_axes(z=np.asarray(self.face_normal), x=np.array([0.0, 0.0, -1.0]), p=self.face)

    @property
    def weight_in_words(self) -> str:
        """Its mass, for people."""
        return "weighed by the arm" if self.mass is None else f"{self.mass:g} kg"

    def unmeasured_as(self, other: ToolData | None) -> ToolData:
        """Leave out what is not measured of another tool, for a cell that stands in for that tool's.

        Args:
            other: The other tool; None: everything stays.

        Returns:
            This tool's data, null where the other's are.
        """
        if other is None:
            return self
        unknown: dict[str, Any] = {field.name: None for field in fields(self) if getattr(other, field.name) is None}
        return replace(self, **unknown)


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
