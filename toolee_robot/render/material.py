"""Surface materials: a two-colour procedural pattern in the body's frame and a metallic-roughness reflection."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.noise import fractal, noise


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

    def albedo(self, points: FloatArray) -> FloatArray:
        """(3, N) linear RGB at points (3, N) [m] in the body's frame; (3, 1) where it is the same everywhere."""
        first = np.asarray(self.color, np.float32)[:, None]
        if self.pattern is Pattern.SOLID and self.wear == 0.0:
            return first
        placed = points + np.asarray(self.offset, np.float32)[:, None]
        out = first
        if self.pattern is not Pattern.SOLID:
            mix = self._mix(placed * np.float32(1.0 / self.scale))
            out = first + mix * (np.asarray(self.color2, np.float32)[:, None] - first)
        if self.wear > 0.0:
            # Dirt has the size of a hand's touch, whatever the pattern's scale.
            dirt = fractal(placed * np.float32(25.0))
            out = out * (1.0 - np.float32(self.wear) * np.clip(2.0 * dirt - 0.7, 0.0, 1.0))
        return out

    def _mix(self, q: FloatArray) -> FloatArray:
        """(N,) share of the second colour at pattern coordinates q (3, N)."""
        along, u, v = q[self.axis], q[(self.axis + 1) % 3], q[(self.axis + 2) % 3]
        if self.pattern is Pattern.CLOUD:
            return fractal(q)
        if self.pattern is Pattern.WOOD:
            slow = np.stack([np.float32(0.12) * along, u, v])
            rings = np.sin(6.3 * (u + 0.35 * v) + 7.0 * noise(0.4 * slow))
            return np.clip(0.45 + 0.3 * rings + 0.5 * (noise(4.0 * slow) - 0.5), 0.0, 1.0).astype(np.float32)
        if self.pattern is Pattern.STRIPES:
            return (np.floor(along) % 2).astype(np.float32)
        if self.pattern is Pattern.CHECKER:
            return ((np.floor(along) + np.floor(u) + np.floor(v)) % 2).astype(np.float32)
        if self.pattern is Pattern.SPECKLE:
            return (noise(q * 1.7) > 0.72).astype(np.float32)
        if self.pattern is Pattern.SCRATCHES:
            return np.clip(noise(np.stack([0.08 * along, 2.0 * u, 2.0 * v])) * 1.3 - 0.15, 0.0, 1.0)
        if self.pattern is Pattern.PLANKS:
            board = np.floor(u)
            grain = noise(np.stack([np.float32(0.7) * along + np.float32(3.1) * board, 8.0 * u, 2.0 * v]))
            gap = ((u - board) < 0.03).astype(np.float32)
            return np.clip(0.6 * grain + 0.4 * noise(np.stack([board, board, 0 * board]) * 1.7) + gap, 0.0, 1.0)
        # tiles: joints of the second colour
        du, da = u - np.floor(u), along - np.floor(along)
        return ((du < 0.04) | (da < 0.04)).astype(np.float32)
