"""Surface materials: a two-colour procedural pattern in the body's frame and a metallic-roughness reflection."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from toolee_robot.render.kernels import texture


class Pattern(StrEnum):
    """How the second colour is mixed into the first."""

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
    """color, color2: linear RGB in [0, 1]. scale: feature size of the pattern [m]. axis: the body axis (0, 1, 2) of
    grain, stripes and scratches. roughness, metallic in [0, 1]. wear: strength in [0, 1] of large-scale dirt.
    offset: shifts the pattern [m], so that equal bodies differ."""

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
        """The last fields of `kernels.texture.Surface`."""
        pattern = _PATTERNS[self.pattern]
        colors = (self.color, self.color2, self.offset)
        return (*colors, pattern, self.axis, 1.0 / self.scale, self.roughness, self.metallic, self.wear)


_PATTERNS = {pattern: getattr(texture, pattern.name) for pattern in Pattern}
