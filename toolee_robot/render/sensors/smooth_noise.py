"""Noise that neighbouring pixels share: what a sensor loses or gets wrong, it does in patches."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.special import ndtr

from toolee_robot.render.mesh import FloatArray


def smooth_noise(shape: tuple[int, ...], size: float, rng: np.random.Generator) -> FloatArray:
    """A random field of zero mean and unit variance.

    Args:
        shape: Height and width [px].
        size: Distance over which neighbours are alike [px]; at 1 and below they are independent.
        rng: Random generator.

    Returns:
        The field, (H, W) float32.
    """
    height, width = shape
    if size <= 1.0:
        return rng.standard_normal((height, width), dtype=np.float32)
    rows, columns = (int(np.ceil(n / size)) + 3 for n in (height, width))
    coarse = rng.standard_normal((rows, columns), dtype=np.float32)
    fine = cv2.resize(coarse, (round(columns * size), round(rows * size)), interpolation=cv2.INTER_CUBIC)
    # The grid lies anywhere over the image, and its nodes vary more than what is between them.
    top, left = int(rng.integers(max(1, int(size)))), int(rng.integers(max(1, int(size))))
    field: FloatArray = fine[top : top + height, left : left + width] / np.float32(max(float(fine.std()), 1e-6))
    return field


def in_patches(chance: FloatArray, size: float, rng: np.random.Generator) -> np.ndarray:
    """Choose pixels in connected patches.

    Args:
        chance: Probability of each pixel to be chosen, (H, W).
        size: Size of the patches [px].
        rng: Random generator.

    Returns:
        Whether each pixel is chosen, (H, W) bool.
    """
    chosen: np.ndarray = ndtr(smooth_noise(chance.shape, size, rng)) < chance
    return chosen
