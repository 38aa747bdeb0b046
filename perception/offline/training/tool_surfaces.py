"""What real tools have on them and rendered ones lack, for training: stickers, print, scratches, rust, lost paint."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor

from toolee_robot.perception.offline.training.backgrounds import Backgrounds, Patches, painted

_STEP = 4
"""Pixels between those that tell a tool's place and extent."""
_STICKERS, _WEAR = 0.3, 0.25
"""Shares of images with stickers and with wear at full strength."""
_PIECE = 96
"""Side of a photograph on a sticker [px]."""
_LETTERS = (8, 36)
"""Lines and columns of a print's cells; every second line is empty, as is every fourth column."""
_WORN = ((125.0, 65.0, 30.0), (190.0, 190.0, 185.0), (40.0, 36.0, 32.0))
"""Rust, bare steel, dirt."""


@dataclass(frozen=True)
class _Extent:
    """A random place on a tool of each image, and the tool's extent.

    Attributes:
        own: Whether a pixel shows the tool, (K, H, W) bool; nowhere if there is none.
        place: The place, x and y, (K, 2) [px].
        angle: Angle from x to the tool's length [rad], (K,).
        half: Half the tool's length and width, (K, 2) [px].
    """

    own: Tensor
    place: Tensor
    angle: Tensor
    half: Tensor

    @staticmethod
    def random(tool: Tensor) -> _Extent:
        coarse = tool[:, ::_STEP, ::_STEP]
        _, height, width = coarse.shape
        lot = (torch.rand(coarse.shape, device=tool.device) * (coarse > 0)).flatten(1).argmax(1)
        ids = coarse.flatten(1).gather(1, lot[:, None])[:, :, None]
        y, x = torch.meshgrid(
            torch.arange(height, device=tool.device), torch.arange(width, device=tool.device), indexing="ij"
        )
        weight = ((coarse == ids) & (ids > 0)).float()
        weight = weight / weight.sum((1, 2), keepdim=True).clamp(min=1)
        middle_x, middle_y = (weight * x).sum((1, 2)), (weight * y).sum((1, 2))
        xx = (weight * x**2).sum((1, 2)) - middle_x**2
        yy = (weight * y**2).sum((1, 2)) - middle_y**2
        xy = (weight * x * y).sum((1, 2)) - middle_x * middle_y
        spread = torch.hypot(0.5 * (xx - yy), xy)
        mean = 0.5 * (xx + yy)
        # A uniform bar's standard deviation is its length by the root of 12.
        half = torch.stack([mean + spread, mean - spread], 1).clamp(min=0.1).sqrt() * math.sqrt(3.0) * _STEP
        place = torch.stack([lot % width, torch.div(lot, width, rounding_mode="floor")], 1).float() * _STEP
        return _Extent((tool == ids) & (ids > 0), place, 0.5 * torch.atan2(2 * xy, xx - yy), half)

    def shading(self, images: Tensor) -> Tensor:
        """Brightness about each pixel by that of the tool, (K, 1, H, W)."""
        grey = F.avg_pool2d(images.mean(1, keepdim=True), 9, 1, 4)
        own = self.own[:, None].float()
        mean = (grey * own).sum((2, 3), keepdim=True) / own.sum((2, 3), keepdim=True).clamp(min=1)
        return (grey / mean.clamp(min=8)).clamp(0.4, 1.7)

    @property
    def inside(self) -> Tensor:
        """1 on the tool, less at its outline, 0 outside, (K, 1, H, W)."""
        own = self.own[:, None].float()
        return own * F.avg_pool2d(own, 3, 1, 1)


def stickers(images: Tensor, tool: Tensor, strength: float, backgrounds: Backgrounds | None = None) -> Tensor:
    """Put one or two stickers or prints on a tool of a share of the images.

    A sticker covers 10 to 60 % of the tool's extent and is stretched along it; it shows a part of a photograph, lines
    as of letters, or stripes. Print has no ground of its own.

    Args:
        images: (B, 3, H, W) in 0..255.
        tool: Ids of tools, 0 for none, (B, H, W).
        strength: Strength; 0: none, 1: full.
        backgrounds: Photographs; None: print alone.

    Returns:
        The images, (B, 3, H, W) in 0..255, unchanged where there is no tool.
    """
    return painted(images, tool, _STICKERS * strength, partial(_stuck, backgrounds=backgrounds), layers=2)


def wear(images: Tensor, tool: Tensor, strength: float) -> Tensor:
    """Give a tool of a share of the images scratches along it and smooth spots of rust, bare steel, dirt or paint.

    Args:
        images: (B, 3, H, W) in 0..255.
        tool: Ids of tools, 0 for none, (B, H, W).
        strength: Strength; 0: none, 1: full.

    Returns:
        The images, (B, 3, H, W) in 0..255, unchanged where there is no tool.
    """
    return painted(images, tool, _WEAR * strength, _worn)


def _stuck(images: Tensor, tool: Tensor, backgrounds: Backgrounds | None) -> Tensor:
    n, device = len(images), images.device
    extent = _Extent.random(tool)
    a, b, turn, many = torch.rand((4, n), device=device)
    along = extent.half[:, 0] * (0.1 + 0.5 * a)
    across = torch.minimum(extent.half[:, 1] * (0.3 + 0.9 * b), 1.2 * along)
    angle = extent.angle + 0.15 * torch.randn(n, device=device)
    angle = torch.where(turn < 0.1, torch.rand(n, device=device) * math.pi, angle)
    angle = angle + math.pi * (many < 0.5)
    half = torch.stack([along, across], 1).clamp(min=2.5)
    patches = Patches.random(extent.place, half, angle, (images.shape[2], images.shape[3]))
    pictures = _prints(n, device)
    if backgrounds is not None:
        photos = torch.cat([backgrounds.pieces(n, _PIECE), torch.ones((n, 1, _PIECE, _PIECE), device=device)], 1)
        pictures = torch.where(torch.rand((n, 1, 1, 1), device=device) < 0.55, photos, pictures)
    content = patches.filled(pictures)
    lit = content[:, :3] * extent.shading(images)
    opaque = 0.75 + 0.25 * torch.rand((n, 1, 1, 1), device=device)
    share = patches.cover[:, None] * extent.inside * content[:, 3:] * opaque
    return torch.lerp(images, lit.clamp(0, 255), share)


def _prints(count: int, device: torch.device) -> Tensor:
    """Lines of letters, or stripes, in two colours; the fourth channel is the opacity, (K, 4, _PIECE, _PIECE)."""
    lines, columns = _LETTERS
    ink = (torch.rand((count, 1, lines, columns), device=device) < 0.7).float()
    stripes = ink[:, :, :1].expand_as(ink)
    gaps = torch.zeros((lines, columns), device=device)
    gaps[::2] = 1.0
    gaps[:, ::4] = 0.0
    ink = torch.where(torch.rand((count, 1, 1, 1), device=device) < 0.7, ink * gaps, stripes)
    # A part of it fills the patch: from two lines to all.
    shown = 0.3 + 0.7 * torch.rand((count, 2), device=device)
    theta = torch.zeros((count, 2, 3), device=device)
    theta[:, 0, 0], theta[:, 1, 1] = shown[:, 0], shown[:, 1]
    theta[:, :, 2] = (torch.rand((count, 2), device=device) * 2 - 1) * (1 - shown)
    grid = F.affine_grid(theta, [count, 1, _PIECE, _PIECE], align_corners=False)
    ink = F.grid_sample(ink, grid, mode="nearest", align_corners=False)
    ground, colour = torch.rand((2, count, 3, 1, 1), device=device) * 255
    plain = torch.rand((2, count, 1, 1, 1), device=device) * 255
    grey = torch.rand((2, count, 1, 1, 1), device=device) < 0.5
    ground, colour = torch.where(grey[0], plain[0], ground), torch.where(grey[1], plain[1], colour)
    bare = torch.rand((count, 1, 1, 1), device=device) < 0.4
    return torch.cat([torch.lerp(ground, colour, ink), torch.where(bare, ink, torch.ones_like(ink))], 1)


def _worn(images: Tensor, tool: Tensor) -> Tensor:
    n, device = len(images), images.device
    size = images.shape[2:]
    extent = _Extent.random(tool)
    spots = torch.zeros((n, 1, *size), device=device)
    for cells, share in ((24, 0.6), (7, 0.4)):
        coarse = torch.rand((n, 1, size[0] // cells + 2, size[1] // cells + 2), device=device)
        spots = spots + share * F.interpolate(coarse, size, mode="bilinear", align_corners=False)
    level, sharp, opaque, scratched = torch.rand((4, n, 1, 1, 1), device=device)
    share = ((spots - 0.5 - 0.15 * level) * (6 + 40 * sharp**2)).clamp(0, 1) * (0.3 + 0.6 * opaque)
    angle = extent.angle + 0.2 * torch.randn(n, device=device)
    patches = Patches.random(extent.place, extent.half * 0.7, angle, (size[0], size[1]))
    lines = patches.filled(torch.rand((n, 1, 64, 5), device=device))
    scratches = ((lines - 0.8) * 12).clamp(0, 1) * (scratched * 1.6 - 0.6).clamp(min=0)
    colours = torch.tensor(_WORN, device=device)[torch.randint(len(_WORN), (n,), device=device)]
    any_colour = torch.rand((n, 3), device=device) * 255
    colours = torch.where(torch.rand((n, 1), device=device) < 0.25, any_colour, colours)
    colours = colours * (0.7 + 0.6 * torch.rand((n, 1), device=device))
    bright = torch.where(torch.rand((n, 1, 1, 1), device=device) < 0.6, 1.5, 0.5)
    out = torch.lerp(images, images * bright, scratches * extent.inside)
    lit = colours[:, :, None, None] * extent.shading(images)
    return torch.lerp(out, lit, share * extent.inside).clamp(0, 255)
