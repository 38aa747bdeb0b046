"""Small separable image filters in numpy (reflected borders), so that the renderer needs no image library."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolee_robot.render.mesh import FloatArray


def gaussian(image: FloatArray, sigma: float) -> FloatArray:
    """(..., H, W) float32 blurred over H and W by a Gaussian of `sigma` [px], cut off at 3 sigma."""
    radius = max(1, int(np.ceil(3.0 * sigma)))
    weights = np.exp(-0.5 * (np.arange(radius + 1) / sigma) ** 2)
    weights = (weights / (2 * weights.sum() - weights[0])).astype(np.float32)
    for axis in (-2, -1):
        pad = [(0, 0)] * image.ndim
        pad[axis] = (radius, radius)
        padded = np.pad(image, pad, mode="reflect")
        n = image.shape[axis]
        starts = range(2 * radius + 1)
        windows = [padded[..., i : i + n] if axis == -1 else padded[..., i : i + n, :] for i in starts]
        total = weights[0] * windows[radius]
        pair = np.empty_like(total)
        for i in range(1, radius + 1):
            np.add(windows[radius - i], windows[radius + i], out=pair)
            pair *= weights[i]
            total += pair
        image = total
    return image


def white(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Independent standard normal numbers by Box and Muller's method: twice as fast as the generator's own."""
    count = int(np.prod(shape))
    half = (count + 1) // 2
    radius = np.sqrt(-2 * np.log(1 - rng.random(half, dtype=np.float32)))
    angle = np.float32(2 * np.pi) * rng.random(half, dtype=np.float32)
    return np.concatenate([radius * np.cos(angle), radius * np.sin(angle)])[:count].reshape(shape)


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
