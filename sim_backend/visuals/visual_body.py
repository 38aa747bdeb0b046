"""What the simulated camera needs to know of the simulated world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from toolee_robot.frames import Array
from toolee_robot.render.mesh import Mesh


@dataclass(frozen=True, eq=False)
class VisualBody:
    """One visible rigid piece. name: unique and stable (it also seeds the surface's pattern). mesh: build it once and
    keep it (`Mesh.build(vertices, faces)`). X_base_body: 4x4, where it is now. finish: what it is made of, for the
    texture ("wood", "steel_bright", "rubber", "plastic", "skin", ... see `toolee_robot.render.palette.finish`).
    color: sRGB in [0, 1]. grain_axis: body axis of a wood's grain. body_id >= 1; pieces of one thing share it."""

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
    """A world that can be looked at."""

    def visual_bodies(self) -> Sequence[VisualBody]:
        """Everything visible but the room, at the present simulated time."""
        ...
