"""Small separable image filters in numpy (reflected borders), so that the renderer needs no image library."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolee_robot.render.mesh import FloatArray


def gaussian(image: FloatArray, sigma: float) -> FloatArray:
    """(H, W) or (H, W, C) float32 blurred by a Gaussian of `sigma` [px], cut off at 3 sigma."""
    radius = max(1, int(np.ceil(3.0 * sigma)))
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    return _separable(image, (weights / weights.sum()).astype(np.float32))


def neighbours(image: NDArray[np.uint8], radius: int) -> NDArray[np.uint8]:
    """(H, W) of 0 and 1: how many ones lie in the square of side 2 * radius + 1 [px, at most 15] about each pixel."""
    for axis in (0, 1):
        total = image.copy()
        for shift in range(1, radius + 1):
            head = tuple(slice(shift, None) if k == axis else slice(None) for k in range(2))
            tail = tuple(slice(None, -shift) if k == axis else slice(None) for k in range(2))
            total[head] += image[tail]
            total[tail] += image[head]
        image = total
    return image


def _separable(image: FloatArray, weights: FloatArray) -> FloatArray:
    radius = len(weights) // 2
    for axis in (0, 1):
        pad = [(0, 0)] * image.ndim
        pad[axis] = (radius, radius)
        padded = np.pad(image, pad, mode="reflect")
        n = image.shape[axis]
        total = np.zeros_like(image)
        for i, weight in enumerate(weights):
            window = [slice(None)] * image.ndim
            window[axis] = slice(i, i + n)
            total += weight * padded[tuple(window)]
        image = total
    return image


def local_range(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest value in each pixel's 3x3 neighbourhood, (H, W) each."""
    low, high = image, image
    for axis in (0, 1):
        pad = [(0, 0)] * 2
        pad[axis] = (1, 1)
        a, b = np.pad(low, pad, mode="edge"), np.pad(high, pad, mode="edge")
        n = image.shape[axis]
        parts = [tuple(slice(i, i + n) if k == axis else slice(None) for k in range(2)) for i in range(3)]
        low = np.minimum(np.minimum(a[parts[0]], a[parts[1]]), a[parts[2]])
        high = np.maximum(np.maximum(b[parts[0]], b[parts[1]]), b[parts[2]])
    return low, high
