"""Depth in the colour camera's pixels: what the depth camera does not see from its own place, and what is left over."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.render.mesh import FloatArray
from toolee_robot.types import CameraIntrinsics

_MARGIN = 0.015
"""Depth by which something must be in front to hide a pixel [m]."""


def hidden_from(depth: FloatArray, K: CameraIntrinsics, baseline: float) -> NDArray[np.bool_]:
    """Find the pixels that a second eye beside the camera does not see, because something nearer is in between.

    Args:
        depth: Depth, (H, W) [m]; 0 where there is nothing.
        K: Intrinsics of the camera.
        baseline: Place of the second eye along the image's x [m].

    Returns:
        Whether each pixel is hidden from it, (H, W) bool. A pixel outside its image is not.
    """
    height, width = depth.shape
    known = depth > 0
    rows, columns = np.nonzero(known)
    z = depth[known]
    there = np.rint(columns - K.fx * baseline / z).astype(np.int64)
    inside = (there >= 0) & (there < width)
    nearest = np.full(height * width, np.float32(np.inf))
    place = rows * width + np.clip(there, 0, width - 1)
    np.minimum.at(nearest, place[inside], z[inside])
    # Surfaces that the second eye sees wider leave gaps of a column: they are closed.
    columns_of_three = np.ones((1, 3), np.uint8)
    closed = cv2.dilate(cv2.erode(nearest.reshape(height, width), columns_of_three), columns_of_three)
    nearest = closed.reshape(-1)
    hidden = np.zeros(depth.shape, np.bool_)
    hidden[known] = inside & (z > nearest[place] + np.float32(_MARGIN))
    return hidden


@dataclass(frozen=True)
class Registration:
    """Registration of a depth camera beside the colour camera.

    Attributes:
        baseline: Place of the depth camera along the image's x [m].
        shift: What the registration is off by, along x and y [px].
    """

    baseline: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)

    @staticmethod
    def random(baseline: float, rng: np.random.Generator, most: float = 1.5) -> Registration:
        """A camera on either side, registered to `most` pixels.

        Args:
            baseline: Distance of the two cameras [m].
            rng: Random generator.
            most: Largest error along an axis [px]; assumed.

        Returns:
            The registration.
        """
        x, y = rng.uniform(-most, most, 2)
        return Registration(float(rng.choice([-baseline, baseline])), (float(x), float(y)))

    def apply(self, reading: FloatArray, true_depth: FloatArray, K: CameraIntrinsics) -> FloatArray:
        """Register a reading.

        Args:
            reading: What the depth camera reads, in the colour camera's pixels, (H, W) [m].
            true_depth: Depth of the surfaces there, (H, W) [m].
            K: Intrinsics of the colour camera.

        Returns:
            The reading without what the depth camera cannot see, shifted, (H, W) float32 [m].
        """
        kept = np.where(hidden_from(true_depth, K, self.baseline), np.float32(0.0), reading)
        move = np.array([[1.0, 0.0, self.shift[0]], [0.0, 1.0, self.shift[1]]])
        return cv2.warpAffine(kept, move, (K.width, K.height), flags=cv2.INTER_NEAREST).astype(np.float32)
