"""Square crops of an image around detections, enlarged and with metric coordinates: the refiner's input.

Boxes are x0, y0, x1, y1 [px] of the image, pixel edges at integer coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

CELLS = 96
"""Cells per side of a square."""
CHANNELS = 8
"""Channels of a square; see `sample_squares`."""

_MARGIN = 1.7
_MIN_SIDE = 24.0
_METRES = 0.05
_MAX_DEPTH = 3.0
_NEAR_QUANTILE = 0.3
_EVERY = 3

MaskAt = Callable[[Tensor, Tensor], Tensor]
"""From columns and rows (N, CELLS, CELLS) int64 of an image's pixels to whether the mask holds them, bool."""


@dataclass(frozen=True)
class Squares:
    """N squares in images.

    Attributes:
        centre: (N, 2) [px].
        side: (N,) [px].
        turn: Rotation of the square's axes in the image, (N,) [rad].
        mirrored: -1 where the square is seen mirrored left to right, else 1, (N,).
    """

    centre: Tensor
    side: Tensor
    turn: Tensor
    mirrored: Tensor

    @classmethod
    def about(cls, boxes: Tensor) -> Squares:
        """Upright squares around the centres of boxes (N, 4), with a margin."""
        side = ((boxes[:, 2:] - boxes[:, :2]).amax(1) * _MARGIN).clamp(min=_MIN_SIDE)
        return cls((boxes[:, :2] + boxes[:, 2:]) / 2, side, torch.zeros_like(side), torch.ones_like(side))

    def mirrored_copy(self) -> Squares:
        """The same squares, mirrored left to right."""
        return Squares(self.centre, self.side, self.turn, -self.mirrored)

    def jittered(self) -> Squares:
        """Squares for training: shifted, scaled, rotated (half of them) and mirrored at random."""
        n, device = len(self.side), self.side.device
        shift = 0.05 * torch.randn((n, 2), device=device) * self.side[:, None]
        side = self.side * torch.exp(0.25 * (2 * torch.rand(n, device=device) - 1))
        turn = torch.where(torch.rand(n, device=device) < 0.5, 0.0, 2 * math.pi * torch.rand(n, device=device))
        mirrored = torch.where(torch.rand(n, device=device) < 0.5, -1.0, 1.0)
        return Squares(self.centre + shift, side, turn, mirrored)

    def boxes(self) -> Tensor:
        """Boxes (N, 4) of upright squares; they may reach beyond the image."""
        half = self.side[:, None] / 2
        return torch.cat([self.centre - half, self.centre + half], 1)

    def offsets(self) -> tuple[Tensor, Tensor]:
        """Offsets [px] of the cells' centres from the square's centre along its own axes.

        Returns:
            x (N, 1, CELLS) and y (N, CELLS, 1).
        """
        steps = (torch.arange(CELLS, device=self.side.device) + 0.5) / CELLS - 0.5
        span = steps * self.side[:, None]
        return span[:, None, :], span[:, :, None]

    def places(self) -> tuple[Tensor, Tensor]:
        """Image coordinates u, v (N, CELLS, CELLS) [px] of the cells' centres."""
        x, y = self.offsets()
        x = x * self.mirrored[:, None, None]
        cos, sin = torch.cos(self.turn)[:, None, None], torch.sin(self.turn)[:, None, None]
        u = self.centre[:, 0, None, None] + cos * x - sin * y
        v = self.centre[:, 1, None, None] + sin * x + cos * y
        return u, v


@dataclass(frozen=True)
class Images:
    """B images of one size.

    Attributes:
        rgb: (B, H, W, 3) uint8.
        depth: (B, H, W) [m], 0 where unknown.
        focal: (B,) [px].
    """

    rgb: Tensor
    depth: Tensor
    focal: Tensor


@torch.no_grad()
def sample_squares(images: Images, index: Tensor, squares: Squares, mask_at: MaskAt) -> tuple[Tensor, Tensor]:
    """Sample squares from images.

    Channels: colour in 0..255 (3); x, y, z from the square's centre and the depth under the mask, in units of 5 cm, x
    and y along the square's axes; whether the depth is known; the mask.

    Args:
        images: The images.
        index: Image of each square, (N,).
        squares: The squares.
        mask_at: Reads the detector's masks.

    Returns:
        (N, CHANNELS, CELLS, CELLS), and the cells' pixels (N, 2, CELLS, CELLS) int64: column and row, -1 beyond the
        image.
    """
    u, v = squares.places()
    height, width = images.rgb.shape[1:3]
    column, row = u.floor().long(), v.floor().long()
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    pixels = torch.where(inside[:, None], torch.stack([column, row], 1), -1)
    column, row = column.clamp(0, width - 1), row.clamp(0, height - 1)
    which = index[:, None, None]
    mask = mask_at(column, row) & inside
    z = images.depth[which, row, column]
    known = inside & (z > 0)
    reference = _depth_of(z, known, mask)[:, None, None]
    z = torch.where(known, z, reference)
    x, y = squares.offsets()
    scale = z / (images.focal[index][:, None, None] * _METRES)
    metres = torch.stack([x * scale, y * scale, (z - reference) / _METRES], 1).clamp(-_MAX_DEPTH, _MAX_DEPTH)
    colour = _colour(images.rgb, which, u, v) * inside[:, None]
    return torch.cat([colour, metres, known[:, None].float(), mask[:, None].float()], 1), pixels


def _depth_of(z: Tensor, known: Tensor, mask: Tensor) -> Tensor:
    """A low quantile of the known depths under the mask, (N,); of all known depths where the mask has none."""
    few = (slice(None), slice(1, None, _EVERY), slice(1, None, _EVERY))
    z, known, mask = z[few].flatten(1), known[few].flatten(1), (known & mask)[few].flatten(1)
    chosen = torch.where(mask.any(1, keepdim=True), mask, known)
    ordered = torch.where(chosen, z, torch.inf).sort(1)[0]
    count = chosen.sum(1)
    place = (_NEAR_QUANTILE * count).long()[:, None]
    return torch.where(count > 0, ordered.gather(1, place)[:, 0], 0.0)


def _colour(rgb: Tensor, which: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Bilinear colour (N, 3, CELLS, CELLS), the border replicated."""
    height, width = rgb.shape[1:3]
    u, v = u - 0.5, v - 0.5
    left, top = u.floor(), v.floor()
    du, dv = (u - left)[..., None], (v - top)[..., None]
    x0, x1 = (left + k for k in (0, 1))
    y0, y1 = (top + k for k in (0, 1))
    x0, x1 = (x.long().clamp(0, width - 1) for x in (x0, x1))
    y0, y1 = (y.long().clamp(0, height - 1) for y in (y0, y1))
    upper = rgb[which, y0, x0].float() * (1 - du) + rgb[which, y0, x1].float() * du
    lower = rgb[which, y1, x0].float() * (1 - du) + rgb[which, y1, x1].float() * du
    return (upper * (1 - dv) + lower * dv).permute(0, 3, 1, 2)
