"""Environment maps and background images on a device."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import warp as wp

from toolee_robot.render.device import DeviceArray, empty, launch, put, rows_of
from toolee_robot.render.kernels import surroundings as kernels
from toolee_robot.render.scene import Backdrop, Environment

_BLURS = (0.05, 0.25, 0.6, 1.0)
"""Blur half-widths [rad] of the maps; the last map is the diffuse irradiance."""
assert len(_BLURS) == kernels.SKY_LEVELS


def sky_maps(environment: Environment, device: str) -> DeviceArray:
    """Blurred environment maps, in the layout of `kernels.surroundings.sky`.

    Args:
        environment: Light from all directions.
        device: Warp device.

    Returns:
        The maps, row-major, (4 * 64 * 64,) vec3, linear RGB.
    """
    lobes = rows_of(kernels.Lobe, [(lobe.direction, lobe.width, lobe.color) for lobe in environment.lobes])
    maps = empty(kernels.SKY_LEVELS * kernels.SKY_SIZE**2, wp.vec3, device)
    colors = (wp.vec3(c) for c in (environment.zenith, environment.horizon, environment.ground))
    launch(kernels.bake, maps.size, *colors, put(lobes, kernels.Lobe, device), _blurs(device), maps, device=device)
    return maps


def picture(backdrop: Backdrop, height: int, width: int, device: str) -> DeviceArray:
    """Background image of a backdrop.

    Args:
        backdrop: The backdrop.
        height: Height of the image [px].
        width: Width of the image [px].
        device: Warp device.

    Returns:
        The image, row-major, (H * W,) vec3, linear RGB.
    """
    rows = [(p.centre, p.half_axes, np.cos(p.angle), np.sin(p.angle), p.oval, p.color) for p in backdrop.patches]
    patches = rows_of(kernels.Patch, rows)
    out = empty(height * width, wp.vec3, device)
    colors = (wp.vec3(c) for c in (backdrop.corner, backdrop.right, backdrop.down))
    launch(kernels.backdrop, out.size, width, *colors, put(patches, kernels.Patch, device), out, device=device)
    return out


@lru_cache
def _blurs(device: str) -> DeviceArray:
    return put(np.array(_BLURS, np.float32), wp.float32, device)
