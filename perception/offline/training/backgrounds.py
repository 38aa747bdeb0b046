"""Photographs behind and beside the tools of training images, and what real tools wear and rendered ones lack."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from toolee_robot.errors import UserError
from toolee_robot.runtime.images import read_image

_SIZE = (424, 512)
"""Height and width to which photographs are cut [px]."""
_BESIDE = 0.3
"""Share of images with photographs on single regions, at full strength."""
_PIECE = 256
"""Side of a photograph on a region [px]."""


class Backgrounds:
    """Photographs that show no tool, held on the device.

    Args:
        folder: Folder of JPEG and PNG files, searched through; of any size.
        device: torch device.

    Raises:
        UserError: The folder has no readable picture.
    """

    def __init__(self, folder: Path, device: torch.device) -> None:
        paths = sorted(p for p in folder.rglob("*") if p.suffix.lower() in (".jpg", ".jpeg", ".png"))
        pictures = []
        for path in paths:
            with suppress(OSError, ValueError):  # of a folder of photographs those that can be used
                if (image := read_image(path, cv2.IMREAD_COLOR)) is not None:
                    pictures.append(_cut(image))
        if not pictures:
            raise UserError(
                f"{folder} holds no JPEG or PNG picture: give a folder of photographs without tools",
                code="user.backgrounds_empty",
            )
        self._pictures = torch.from_numpy(np.stack(pictures)).to(device)

    def __len__(self) -> int:
        return len(self._pictures)

    def behind(self, images: Tensor, tool: Tensor, strength: float) -> Tensor:
        """Put a photograph behind the tools of a third of the images, some of them half transparent.

        The depth stays that of the rendered scene: the photograph is its print and texture.

        Args:
            images: (B, 3, H, W) in 0..255.
            tool: Whether a pixel shows a tool, (B, H, W) bool.
            strength: Strength; 0: none, 1: full.

        Returns:
            The images, (B, 3, H, W) in 0..255.
        """
        n, device = len(images), images.device
        chosen = self._pictures[torch.randint(len(self._pictures), (n,), device=device)]
        # A random part of the picture, from a quarter to all of its width, either way round.
        size = 0.25 + 0.75 * torch.rand(n, device=device)
        mirror = torch.where(torch.rand(n, device=device) < 0.5, -1.0, 1.0)
        place = (torch.rand((n, 2), device=device) * 2 - 1) * (1 - size[:, None])
        theta = torch.zeros((n, 2, 3), device=device)
        theta[:, 0, 0], theta[:, 1, 1], theta[:, :, 2] = size * mirror, size, place
        grid = F.affine_grid(theta, [n, 1, *images.shape[2:]], align_corners=False)
        photo = F.grid_sample(chosen.permute(0, 3, 1, 2).float(), grid, padding_mode="reflection", align_corners=False)
        opaque = torch.rand((n, 1, 1, 1), device=device).clamp(min=0.25) * 1.3
        share = opaque.clamp(max=1.0) * (torch.rand((n, 1, 1, 1), device=device) < 0.35 * strength)
        # The soft edge keeps a tool's outline from being cut as with scissors.
        inside = F.avg_pool2d(tool[:, None].float(), 3, 1, 1)
        share = share * (1 - inside)
        return images * (1 - share) + photo * share

    def beside(self, images: Tensor, tool: Tensor, strength: float) -> Tensor:
        """Put one or two photographs on regions beside and behind the tools of a share of the images.

        A region is a quadrilateral or oval of 5 to 45 % of the image's width, half of them close to a tool: their edges
        and texture lie beside its outline.

        Args:
            images: (B, 3, H, W) in 0..255.
            tool: Whether a pixel shows a tool, (B, H, W) bool.
            strength: Strength; 0: none, 1: full.

        Returns:
            The images, (B, 3, H, W) in 0..255.
        """
        return painted(images, tool, _BESIDE * strength, self._pasted, layers=2)

    def pieces(self, count: int, side: int) -> Tensor:
        """Cut random squares out of random photographs.

        Args:
            count: Number of squares.
            side: Side [px], at most the photographs' height.

        Returns:
            The squares, (count, 3, side, side) float in 0..255.
        """
        device = self._pictures.device
        which = torch.randint(len(self._pictures), (count,), device=device)
        _, height, width, _ = self._pictures.shape
        step = 1 + (torch.rand(count, device=device) * (height // side)).long().clamp(max=height // side - 1)
        window = (step * (side - 1) + 1)[:, None]
        room = torch.tensor([height, width], device=device) - window
        corner = (torch.rand((count, 2), device=device) * (room + 1)).long()
        ticks = torch.arange(side, device=device)[None] * step[:, None]
        rows, columns = (corner[:, :1] + ticks)[:, :, None], (corner[:, 1:] + ticks)[:, None, :]
        return self._pictures[which[:, None, None], rows, columns].permute(0, 3, 1, 2).float()

    def _pasted(self, images: Tensor, tool: Tensor) -> Tensor:
        n, device = len(images), images.device
        _, _, height, width = images.shape
        coarse = tool[:, ::8, ::8]
        columns = coarse.shape[2]
        chance, lot = (torch.rand(coarse.shape, device=device) * coarse).flatten(1).max(1)
        near = torch.stack([lot % columns, torch.div(lot, columns, rounding_mode="floor")], 1) * 8.0
        near = near + 0.12 * width * torch.randn((n, 2), device=device)
        anywhere = torch.rand((n, 2), device=device) * torch.tensor([width, height], device=device)
        # Without a tool, or with one between the grid's pixels, no place is near it.
        beside = (torch.rand(n, device=device) < 0.5) & (chance > 0)
        centre = torch.where(beside[:, None], near, anywhere)
        half = 0.5 * width * (0.05 + 0.4 * torch.rand((n, 2), device=device))
        angle = torch.rand(n, device=device) * 2 * math.pi
        patches = Patches.random(centre, half, angle, (height, width))
        photo = patches.filled(self.pieces(n, _PIECE))
        opaque = (torch.rand((n, 1, 1, 1), device=device).clamp(min=0.3) * 1.5).clamp(max=1)
        inside = F.avg_pool2d(tool[:, None].float(), 3, 1, 1)
        return torch.lerp(images, photo, patches.cover[:, None] * opaque * (1 - inside))


def _cut(image: np.ndarray) -> np.ndarray:
    """The middle of a picture, resized to _SIZE, as RGB."""
    height, width = image.shape[:2]
    scale = max(_SIZE[0] / height, _SIZE[1] / width)
    size = max(_SIZE[1], round(width * scale)), max(_SIZE[0], round(height * scale))
    image = cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    y, x = (image.shape[0] - _SIZE[0]) // 2, (image.shape[1] - _SIZE[1]) // 2
    return np.ascontiguousarray(image[y : y + _SIZE[0], x : x + _SIZE[1], ::-1])


@dataclass(frozen=True)
class Patches:
    """One patch in each of K images.

    Attributes:
        u: Coordinate along the patch, -1..1 on it, (K, H, W).
        v: Coordinate across the patch, -1..1 on it, (K, H, W).
        cover: Share of a pixel that the patch covers, (K, H, W).
    """

    u: Tensor
    v: Tensor
    cover: Tensor

    @staticmethod
    def random(centre: Tensor, half: Tensor, angle: Tensor, size: tuple[int, int]) -> Patches:
        """Draw the shapes of patches: sheared, tapered, with corners from sharp to an oval's.

        Args:
            centre: Their centres, x and y, (K, 2) [px].
            half: Half their length and width, (K, 2) [px].
            angle: Angle from x to their length [rad], (K,).
            size: Height and width of the images [px].

        Returns:
            The patches.
        """
        n, device = len(centre), centre.device
        x = torch.arange(size[1], device=device)[None, None, :] - centre[:, :1, None]
        y = torch.arange(size[0], device=device)[None, :, None] - centre[:, 1:, None]
        cos, sin = torch.cos(angle)[:, None, None], torch.sin(angle)[:, None, None]
        u = (cos * x + sin * y) / half[:, :1, None]
        v = (cos * y - sin * x) / half[:, 1:, None]
        shear, taper = (torch.rand((2, n, 1, 1), device=device) - 0.5) * 0.6
        v = (v + shear * u) / (1 + taper * u.clamp(-1, 1))
        corner = torch.rand((n, 1, 1), device=device) ** 2 * 0.95 + 0.05
        # The cover falls off over the last pixel, inside the corners: tighter ones would leave none of it full.
        narrow = half.amin(1)[:, None, None]
        corner = torch.maximum(corner, 1 / narrow).clamp(max=1)
        beyond = torch.hypot((u.abs() - 1 + corner).clamp(min=0), (v.abs() - 1 + corner).clamp(min=0))
        return Patches(u, v, ((corner - beyond) * narrow).clamp(0, 1))

    def filled(self, pictures: Tensor) -> Tensor:
        """Pictures stretched over the patches.

        Args:
            pictures: One for each patch, (K, C, h, w).

        Returns:
            The images, (K, C, H, W); beyond the patches the pictures go on mirrored.
        """
        grid = torch.stack([self.u, self.v], -1)
        return F.grid_sample(pictures, grid, padding_mode="reflection", align_corners=False)


def painted(
    images: Tensor, tool: Tensor, share: float, paint: Callable[[Tensor, Tensor], Tensor], layers: int = 1
) -> Tensor:
    """Paint a share of the images of a batch, drawn without waiting for the device.

    Args:
        images: The images, (B, 3, H, W).
        tool: What `paint` is told of each image's tool, (B, H, W).
        share: Share of the images on average, 0 to 1.
        paint: Paints the images (K, 3, H, W) with tools (K, H, W) that are given to it.
        layers: How often it may paint; of the painted images half are painted again.

    Returns:
        The images, (B, 3, H, W).
    """
    count = int(share * len(images) + float(torch.rand(())))
    rows = torch.randperm(len(images), device=images.device)[:count]
    for layer in range(layers):
        chosen = rows[: len(rows) >> layer]
        if not len(chosen):
            break
        images = images.clone() if layer == 0 else images
        images[chosen] = paint(images[chosen], tool[chosen])
    return images


_STEP = 4
"""Pixels between those that tell a tool's place and extent."""
_STICKERS, _WEAR = 0.3, 0.25
"""Shares of images with stickers and with wear at full strength."""
_STICKER_PIECE = 96
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
        photos = torch.cat(
            [backgrounds.pieces(n, _STICKER_PIECE), torch.ones((n, 1, _STICKER_PIECE, _STICKER_PIECE), device=device)],
            1,
        )
        pictures = torch.where(torch.rand((n, 1, 1, 1), device=device) < 0.55, photos, pictures)
    content = patches.filled(pictures)
    lit = content[:, :3] * extent.shading(images)
    opaque = 0.75 + 0.25 * torch.rand((n, 1, 1, 1), device=device)
    share = patches.cover[:, None] * extent.inside * content[:, 3:] * opaque
    return torch.lerp(images, lit.clamp(0, 255), share)


def _prints(count: int, device: torch.device) -> Tensor:
    """Lines of letters, or stripes, in two colours; the fourth channel is the opacity, (K, 4, side, side)."""
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
    grid = F.affine_grid(theta, [count, 1, _STICKER_PIECE, _STICKER_PIECE], align_corners=False)
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
