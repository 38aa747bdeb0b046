"""Surface materials: two-colour procedural patterns in the body frame, metallic-roughness reflection."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from toolee_robot.render.kernels import texture


class Pattern(StrEnum):
    """Procedural patterns that mix the two colours of a material."""

    SOLID = "solid"
    CLOUD = "cloud"
    WOOD = "wood"
    STRIPES = "stripes"
    CHECKER = "checker"
    SPECKLE = "speckle"
    SCRATCHES = "scratches"
    PLANKS = "planks"
    TILES = "tiles"


@dataclass(frozen=True)
class Material:
    """A surface material.

    Attributes:
        color: First colour, linear RGB in [0, 1].
        color2: Second colour, linear RGB in [0, 1].
        pattern: Pattern of the two colours.
        scale: Feature size of the pattern [m].
        axis: Body axis (0, 1, 2) of grain, stripes and scratches.
        roughness: Roughness in [0, 1].
        metallic: Metalness in [0, 1].
        wear: Strength of large-scale dirt in [0, 1].
        offset: Offset of the pattern in the body frame [m]; it makes equal bodies differ.
    """

    color: tuple[float, float, float] = (0.6, 0.6, 0.6)
    color2: tuple[float, float, float] = (0.4, 0.4, 0.4)
    pattern: Pattern = Pattern.SOLID
    scale: float = 0.02
    axis: int = 2
    roughness: float = 0.6
    metallic: float = 0.0
    wear: float = 0.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def row(self) -> tuple[Any, ...]:
        """Values of the material fields, the last ones, of `kernels.texture.Surface`."""
        pattern = _PATTERNS[self.pattern]
        colors = (self.color, self.color2, self.offset)
        return (*colors, pattern, self.axis, 1.0 / self.scale, self.roughness, self.metallic, self.wear)


_PATTERNS = {pattern: getattr(texture, pattern.name) for pattern in Pattern}
