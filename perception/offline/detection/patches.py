"""Patches in training images: quadrilaterals, rounded rectangles and ovals with coordinates of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor


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
