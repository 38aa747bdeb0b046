"""What a depth camera looks at, the rendered surfaces before any sensor, and smooth noise on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.special import ndtr

from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.renderer import Image
from toolee_robot.render.scene import Rendering


@dataclass(frozen=True, eq=False)
class Surface:
    """The surfaces in a camera's pixels.

    Attributes:
        depth: True depth, (H, W) float32 [m]; 0 where there is nothing.
        cos_incidence: Cosine of the angle between ray and surface normal, (H, W) float32.
        shininess: Shininess in [0, 1], (H, W) float32.
        brightness: Linear brightness in [0, 1] as the colour camera sees it, (H, W) float32; the best guess here at
            what the surface returns of the sensor's own light.
    """

    depth: FloatArray
    cos_incidence: FloatArray
    shininess: FloatArray
    brightness: FloatArray

    @staticmethod
    def of(image: Image | Rendering) -> Surface:
        """The surfaces of a rendered image.

        Args:
            image: The image, on any device or in memory.

        Returns:
            The surfaces, in memory.
        """
        brightness = (_in_memory(image.rgb).mean(axis=2, dtype=np.float32) / np.float32(255.0)) ** np.float32(2.2)
        depth, cos_incidence, shininess = map(_in_memory, (image.depth, image.cos_incidence, image.shininess))
        return Surface(depth, cos_incidence, shininess, brightness)


def _in_memory(part: Any) -> Any:
    return part if isinstance(part, np.ndarray) else part.numpy()


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
