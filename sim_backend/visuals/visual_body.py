"""The interface between the simulated camera and the simulated world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from toolee_robot.frames import Array
from toolee_robot.render.mesh import Mesh


@dataclass(frozen=True, eq=False)
class VisualBody:
    """One visible rigid body.

    Attributes:
        name: Unique and stable name, which also seeds the surface pattern.
        mesh: Mesh in the body's frame; built once and kept.
        X_base_body: Current pose, 4x4.
        finish: Material for the texture ("wood", "steel_bright", "rubber", "plastic", "skin", ...), see
            `toolee_robot.render.palette.finish`.
        color: Color, sRGB in [0, 1].
        roughness: Roughness of the surface in [0, 1].
        metallic: Metalness of the surface in [0, 1].
        grain_axis: Body axis of a wood's grain: 0, 1 or 2.
        body_id: Id in ground-truth renderings, at least 1; parts of one object share it.
    """

    name: str
    mesh: Mesh
    X_base_body: Array
    finish: str
    color: tuple[float, float, float]
    roughness: float = 0.5
    metallic: float = 0.0
    grain_axis: int = 2
    body_id: int = 1


class VisualWorld(Protocol):
    """A world that can be rendered.

    Attributes:
        table_height: Height of the table's top over the base plane [m].
    """

    table_height: float

    def visual_bodies(self) -> Sequence[VisualBody]:
        """The visual bodies at the current simulated time, without the room."""
