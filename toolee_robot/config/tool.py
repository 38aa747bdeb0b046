"""The tool that a person hands over, as its data sheet or a ruler and scales tell it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.config.values import STRICT, Positive
from toolee_robot.frames import Array, frame_from_axes


@dataclass(frozen=True)
class ToolData:
    """A hammer, measured. No field has a default: nobody but the lab knows its hammer.

    Its frame `tool`: origin on the handle's axis where the hand holds it, z along the handle towards the head, x to the
    side that strikes. How the tool really lies in the hand is what the camera finds out.
    """

    __pydantic_config__ = STRICT
    name: str
    """What people call it."""
    grip_radius: Positive
    """Radius of the handle where the hand holds it [m]; of an oval one the mean."""
    face: tuple[float, float, float]
    """Middle of the striking face in `tool` [m]."""
    face_normal: tuple[float, float, float]
    """Direction in which the face strikes, in `tool`; any length."""
    mass: Positive
    """Mass of the whole tool [kg]."""
    center_of_mass: tuple[float, float, float]
    """Centre of mass of the whole tool in `tool` [m]."""

    def __post_init__(self) -> None:
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
    def X_tool_face(self) -> Array:
        """Pose of the striking face, (4, 4): z is its normal, x points towards the handle's butt."""
        return frame_from_axes(z=np.asarray(self.face_normal), x=np.array([0.0, 0.0, -1.0]), p=self.face)
