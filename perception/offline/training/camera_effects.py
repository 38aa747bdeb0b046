"""What light, cameras and drivers do to a picture, for training: colour casts, exposure, motion, lost depth."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

_BLOCK = 8
"""Width of JPEG's blocks [px]."""
_MOTION = 9
"""Width of the motion kernel [px]."""
_GLOW = 8
"""Width of the cells over which highlights spread [px]."""


def camera_effects(images: Tensor, strength: float) -> Tensor:
    """Vary light, exposure, sharpness, motion blur and compression, each of some images.

    Args:
        images: (B, 3, H, W) in 0..255.
        strength: Strength; 0: none, 1: full.

    Returns:
        The images, (B, 3, H, W) in 0..255.
    """
    images = _sometimes(0.25 * strength, images, tint)
    images = _sometimes(0.15 * strength, images, vignette)
    images = _sometimes(0.25 * strength, images, expose)
    images = _sometimes(0.12 * strength, images, bloom)
    images = _sometimes(0.2 * strength, images, motion_blur)
    images = _sometimes(0.2 * strength, images, sharpen)
    return _sometimes(0.3 * strength, images, compress)


def tint(images: Tensor) -> Tensor:
    """Light of a colour, from a bulb's to a blue sky's, with a fluorescent lamp's green; of half, mixed over the image.

    Args:
        images: (B, 3, H, W) in 0..255.

    Returns:
        The images, (B, 3, H, W) in 0..255.
    """
    n, device = len(images), images.device
    warm, green, bright = torch.rand((3, n, 2, 2), device=device) * 2 - 1
    green = green.abs() ** 3 * torch.sign(green + 0.4)
    corners = torch.stack([1 + 0.4 * warm, 1 + 0.22 * green, 1 - 0.45 * warm], 1) * torch.exp(0.35 * bright)[:, None]
    mixed = torch.rand((n, 1, 1, 1), device=device) < 0.5
    corners = torch.where(mixed, corners, corners[:, :, :1, :1])
    light = F.interpolate(corners, images.shape[2:], mode="bilinear", align_corners=True)
    light = light / light.mean((1, 2, 3), keepdim=True)
    return (images * light).clamp(0, 255)


def vignette(images: Tensor) -> Tensor:
    """Darken by up to 80 % towards the corners, about a centre that is not always the image's.

    Args:
        images: (B, 3, H, W) in 0..255.

    Returns:
        The images, (B, 3, H, W) in 0..255.
    """
    n, device = len(images), images.device
    x = torch.linspace(-1, 1, images.shape[3], device=device)[None, None, None, :]
    y = torch.linspace(-1, 1, images.shape[2], device=device)[None, None, :, None]
    across, down = 0.15 * torch.randn((2, n, 1, 1, 1), device=device)
    amount = 0.2 + 0.6 * torch.rand((n, 1, 1, 1), device=device)
    return images * (1 - amount * ((x - across) ** 2 + (y - down) ** 2).clamp(max=2) / 2)


def bloom(images: Tensor) -> Tensor:
    """Clip highlights and let their light spread over what is near.

    Args:
        images: (B, 3, H, W) in 0..255.

    Returns:
        The images, (B, 3, H, W) in 0..255.
    """
    n, device = len(images), images.device
    gain, amount = torch.rand((2, n, 1, 1, 1), device=device)
    bright = images * (1.05 + 0.6 * gain)
    spilt = F.avg_pool2d((bright - 225).clamp(0, 255), _GLOW, ceil_mode=True, count_include_pad=False)
    spilt = F.avg_pool2d(spilt, 5, 1, 2, count_include_pad=False)
    glow = F.interpolate(spilt, images.shape[2:], mode="bilinear", align_corners=False)
    return (bright + glow * (0.3 + 0.9 * amount)).clamp(0, 255)


def expose(images: Tensor) -> Tensor:
    """Underexpose by up to 2.5 stops or overexpose by 1.5, with the grain of a dark picture and clipped highlights.

    Half of the dark pictures are amplified again, with their grain, as a camera's automatic gain does.

    Args:
        images: (B, 3, H, W) in 0..255.

    Returns:
        The images, (B, 3, H, W) in 0..255.
    """
    stops = torch.rand((len(images), 1, 1, 1), device=images.device) * 4.0 - 2.5
    under = stops.clamp(max=0).abs()
    lifted, colour = torch.rand((2, *stops.shape), device=images.device)
    grain = torch.randn_like(images) * (2.0 + 2.0 * under)
    # Low light takes the colours first.
    grey = images.mean(1, keepdim=True)
    images = torch.lerp(images, grey, (0.2 * colour * under).clamp(max=0.8))
    gain = torch.exp2(under * (lifted * 2 - 1).clamp(min=0))
    return ((images * torch.exp2(stops) + grain) * gain).clamp(0, 255)


def motion_blur(images: Tensor) -> Tensor:
    """Blur along a straight line of up to 9 px, another one for each image.

    Args:
        images: (B, 3, H, W) in 0..255.

    Returns:
        The images, (B, 3, H, W) in 0..255.
    """
    n, device = len(images), images.device
    angle = torch.rand((n, 1, 1), device=device) * math.pi
    length = torch.rand((n, 1, 1), device=device) * (_MOTION // 2)
    y, x = torch.meshgrid(*[torch.arange(_MOTION, device=device) - _MOTION // 2] * 2, indexing="ij")
    along, across = x * torch.cos(angle) + y * torch.sin(angle), y * torch.cos(angle) - x * torch.sin(angle)
    kernel = (1 - across.abs()).clamp(min=0) * (along.abs() <= length + 0.5)
    kernel = (kernel / kernel.sum((1, 2), keepdim=True)).repeat_interleave(3, 0)[:, None]
    flat = F.pad(images.reshape(1, 3 * n, *images.shape[2:]), (_MOTION // 2,) * 4, mode="replicate")
    return F.conv2d(flat, kernel.to(images.dtype), groups=3 * n).view_as(images)


def sharpen(images: Tensor) -> Tensor:
    """Add up to twice the difference from the blurred image, as small cameras do.

    Args:
        images: (B, 3, H, W) in 0..255.

    Returns:
        The images, (B, 3, H, W) in 0..255.
    """
    amount = torch.rand((len(images), 1, 1, 1), device=images.device) * 2
    soft = F.avg_pool2d(F.pad(images, (1, 1, 1, 1), mode="replicate"), 3, 1)
    return (images + amount * (images - soft)).clamp(0, 255)


def compress(images: Tensor) -> Tensor:
    """Quantise the cosine transform of 8 x 8 blocks, as JPEG does at a low quality; colour at half the resolution.

    Args:
        images: (B, 3, H, W) in 0..255.

    Returns:
        The images, (B, 3, H, W) in 0..255.
    """
    n, _, height, width = images.shape
    padded = F.pad(images, (0, -width % (2 * _BLOCK), 0, -height % (2 * _BLOCK)), mode="replicate")
    grey = padded.mean(1, keepdim=True)
    colour = F.avg_pool2d(padded - grey, 2)
    step = 4 + torch.rand((n, 1, 1, 1), device=images.device) * 20
    k = torch.arange(_BLOCK, device=images.device, dtype=images.dtype)
    basis = torch.cos((k + 0.5) * k[:, None] * math.pi / _BLOCK) * math.sqrt(2 / _BLOCK)
    basis[0] /= math.sqrt(2)
    weights = 1 + 0.5 * (k + k[:, None])

    def quantised(x: Tensor) -> Tensor:
        b, c, h, w = x.shape
        blocks = x.reshape(b, c, h // _BLOCK, _BLOCK, w // _BLOCK, _BLOCK).transpose(3, 4)
        size = step.view(b, 1, 1, 1, 1, 1) * weights
        blocks = torch.round(basis @ blocks @ basis.T / size) * size
        return (basis.T @ blocks @ basis).transpose(3, 4).reshape(b, c, h, w)

    colour = F.interpolate(quantised(colour), scale_factor=2, mode="bilinear", align_corners=False)
    return (quantised(grey) + colour)[..., :height, :width].clamp(0, 255)


def lose_depth(depth: Tensor, tool: Tensor, strength: float) -> Tensor:
    """Lose depth as sensors do: all of it of a few images, ranges of polished tools, and a coarse step.

    Args:
        depth: (B, H, W) [m], 0 where unknown.
        tool: Whether a pixel shows a tool, (B, H, W) bool.
        strength: Strength; 0: none, 1: full.

    Returns:
        The depth, (B, H, W) [m].
    """
    n, device = len(depth), depth.device
    chance = torch.rand((3, n, 1, 1), device=device)
    depth = depth * (chance[0] >= 0.04 * strength)
    # Smooth noise above a level makes connected holes.
    coarse = torch.rand((n, 1, depth.shape[1] // 12 + 1, depth.shape[2] // 12 + 1), device=device)
    smooth = F.interpolate(coarse, depth.shape[1:], mode="bilinear", align_corners=False)[:, 0]
    level = 0.3 + 0.5 * torch.rand((n, 1, 1), device=device)
    holes = tool & (smooth > level) & (chance[1] < 0.2 * strength)
    depth = torch.where(holes, 0.0, depth)
    step = 0.0005 + 0.008 * torch.rand((n, 1, 1), device=device) * depth**2
    return torch.where(chance[2] < 0.2 * strength, torch.round(depth / step.clamp(min=1e-6)) * step, depth)


def _sometimes(share: float, images: Tensor, effect: Callable[[Tensor], Tensor]) -> Tensor:
    """Apply an effect to a share of the images."""
    chosen = torch.rand(len(images), device=images.device) < share
    if not bool(chosen.any()):
        return images
    images = images.clone()
    images[chosen] = effect(images[chosen])
    return images
