"""Lenses: pinhole intrinsics with distortion, the rays of their pixels, and undistortion."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import NotReadyError
from toolee_robot.frames import Array
from toolee_robot.types import CameraIntrinsics

ITERATIONS = 100
"""Most steps to find the direction of a pixel."""
PRECISION = 1e-3
"""Error of a pixel's direction [px]."""


class LensModel(StrEnum):
    """What the coefficients of a lens mean.

    NONE: there is no distortion. BROWN_CONRADY: OpenCV's model, k1 k2 p1 p2 k3 (k4 k5 k6), from the true direction to
    the one in the image. MODIFIED_BROWN_CONRADY: librealsense's, k1 k2 p1 p2 k3, with the tangential terms of the
    radially distorted direction.
    """

    NONE = "none"
    BROWN_CONRADY = "brown_conrady"
    MODIFIED_BROWN_CONRADY = "modified_brown_conrady"


@dataclass(frozen=True)
class Lens:
    """A camera's lens.

    Attributes:
        intrinsics: Its pinhole part; pixel centres are at integer coordinates.
        model: What the coefficients mean.
        coefficients: Distortion k1, k2, p1, p2, k3, and k4 to k6 where the model is rational.
    """

    intrinsics: CameraIntrinsics
    model: LensModel = LensModel.NONE
    coefficients: tuple[float, ...] = ()

    @property
    def distorts(self) -> bool:
        """Whether a pixel is elsewhere than a pinhole camera would have it."""
        return self.model is not LensModel.NONE and any(self.coefficients)

    def rays(self) -> NDArray[np.float32]:
        """Directions of the pixels.

        Returns:
            x and y of each pixel's direction at z = 1, (2, H, W), in the camera's frame.

        Raises:
            NotReadyError: The coefficients are no lens's.
        """
        k = self.intrinsics
        u, v = np.meshgrid(np.arange(k.width, dtype=np.float64), np.arange(k.height, dtype=np.float64))
        image = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy])
        return (self._solved(image) if self.distorts else image).astype(np.float32)

    def undistortion(self) -> Undistortion:
        """The map from this lens's image to that of a pinhole camera with the same intrinsics."""
        k = self.intrinsics
        u, v = np.meshgrid(np.arange(k.width, dtype=np.float64), np.arange(k.height, dtype=np.float64))
        true = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy])
        if self.distorts:
            true = self._distorted(true)
        x = (true[0] * k.fx + k.cx).astype(np.float32)
        y = (true[1] * k.fy + k.cy).astype(np.float32)
        return Undistortion(*cv2.convertMaps(x, y, cv2.CV_16SC2))

    def _distorted(self, x: Array) -> Array:
        """Directions in the image of true directions, (2, H, W) at z = 1."""
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.coefficients, *(0.0,) * (8 - len(self.coefficients)))
        a, b = x
        r2 = a * a + b * b
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        c, d = (a * radial, b * radial) if self.model is LensModel.MODIFIED_BROWN_CONRADY else (a, b)
        return np.stack(
            [
                a * radial + 2 * p1 * c * d + p2 * (r2 + 2 * c * c),
                b * radial + p1 * (r2 + 2 * d * d) + 2 * p2 * c * d,
            ]
        )

    def _solved(self, image: Array) -> Array:
        """True directions of directions in the image, (2, H, W) at z = 1, by fixed-point iteration."""
        true = image.copy()
        for _ in range(ITERATIONS):
            off = image - self._distorted(true)
            true += off
            if np.abs(off).max() < PRECISION / self.intrinsics.fx:
                return true
        message = "the lens distorts so much that its pixels have no direction: its coefficients are wrong"
        raise NotReadyError(message, code="not_ready.camera_lens")


@dataclass(frozen=True)
class Undistortion:
    """A map that undistorts colour images; see `Lens.undistortion`."""

    coarse: NDArray[Any]
    """OpenCV's fixed-point map, whole pixels, (H, W, 2)."""
    fine: NDArray[Any]
    """OpenCV's fixed-point map, fractions, (H, W)."""

    def __call__(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Undistort a colour image.

        Args:
            rgb: The image, (H, W, 3).

        Returns:
            The image of the pinhole camera, (H, W, 3), interpolated linearly; black outside.
        """
        return np.asarray(cv2.remap(rgb, self.coarse, self.fine, cv2.INTER_LINEAR), np.uint8)
