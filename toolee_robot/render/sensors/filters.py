"""A Gaussian blur and white noise on a device."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import warp as wp
from scipy.special import ndtri

from toolee_robot.render.device import DeviceArray, empty, launch, put
from toolee_robot.render.kernels import filters as kernels


def gaussian(image: DeviceArray, sigma: float, device: str, gain: float = 1.0) -> DeviceArray:
    """Blur images by a Gaussian that is cut off at 3 sigma; borders are reflected.

    Args:
        image: The images, (C, H, W) float32.
        sigma: Standard deviation [px].
        device: Warp device.
        gain: Factor on the result.

    Returns:
        The blurred images, (C, H, W) float32.
    """
    radius = max(1, int(np.ceil(3.0 * sigma)))
    weights = np.exp(-0.5 * (np.arange(radius + 1) / sigma) ** 2)
    weights *= np.sqrt(gain) / (2 * weights.sum() - weights[0])  # once for each axis
    weights = put(weights.astype(np.float32), wp.float32, device)
    _, height, width = image.shape
    half, out = empty(image.size, wp.float32, device), empty(image.shape, wp.float32, device)
    launch(kernels.blur, image.size, image.reshape(-1), weights, 1, width, half, device=device)
    launch(kernels.blur, image.size, half, weights, width, height, out.reshape(-1), device=device)
    return out


def white(seed: int, shape: tuple[int, int, int], device: str) -> DeviceArray:
    """Independent standard normal numbers; equal seeds give equal ones on every device.

    Args:
        seed: The seed.
        shape: Their shape, (C, H, W).
        device: Warp device.

    Returns:
        The numbers, (C, H, W) float32.
    """
    out = empty(shape, wp.float32, device)
    launch(kernels.white, (out.size + 1) // 2, seed, normal_table(device), out.reshape(-1), device=device)
    return out


@lru_cache
def normal_table(device: str) -> DeviceArray:
    """Quantiles of the standard normal distribution that `kernels.filters.normals` looks up, up to 4.3 sigma.

    Args:
        device: Warp device.

    Returns:
        The quantiles, (65536,) float32.
    """
    shares = (np.arange(kernels.NORMALS) + 0.5) / kernels.NORMALS
    return put(ndtri(shares).astype(np.float32), wp.float32, device)
