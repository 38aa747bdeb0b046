"""Lenses: pinhole intrinsics with distortion, the rays of their pixels, and undistortion."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.types import CameraIntrinsics

_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)


class LensModel(StrEnum):
    """What the coefficients of a lens mean.

    NONE: there is no distortion. BROWN_CONRADY: OpenCV's model, k1 k2 p1 p2 k3 (k4 k5 k6), from the true direction to
    the one in the image. INVERSE_BROWN_CONRADY: the same polynomial from the image to the true direction, as
    librealsense defines it.
    """

    NONE = "none"
    BROWN_CONRADY = "brown_conrady"
    INVERSE_BROWN_CONRADY = "inverse_brown_conrady"


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
        """
        k = self.intrinsics
        u, v = np.meshgrid(np.arange(k.width, dtype=np.float64), np.arange(k.height, dtype=np.float64))
        image = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy])
        if not self.distorts:
            return image.astype(np.float32)
        of_image = _solve if self.model is LensModel.BROWN_CONRADY else _polynomial
        return of_image(image, self.coefficients).astype(np.float32)

    def undistortion(self) -> Undistortion:
        """The map from this lens's image to that of a pinhole camera with the same intrinsics."""
        k = self.intrinsics
        u, v = np.meshgrid(np.arange(k.width, dtype=np.float64), np.arange(k.height, dtype=np.float64))
        true = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy])
        if self.distorts:
            to_image = _polynomial if self.model is LensModel.BROWN_CONRADY else _solve
            true = to_image(true, self.coefficients)
        x = (true[0] * k.fx + k.cx).astype(np.float32)
        y = (true[1] * k.fy + k.cy).astype(np.float32)
        return Undistortion(*cv2.convertMaps(x, y, cv2.CV_16SC2))


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


def _polynomial(x: Array, coefficients: tuple[float, ...]) -> Array:
    """OpenCV's distortion of directions, (2, H, W) at z = 1."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, *(0.0,) * (8 - len(coefficients)))
    a, b = x
    r2 = a * a + b * b
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return np.stack(
        [
            a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a),
            b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b,
        ]
    )


def _solve(x: Array, coefficients: tuple[float, ...]) -> Array:
    """The directions whose `_polynomial` is `x`, (2, H, W)."""
    points = np.ascontiguousarray(x.reshape(2, -1).T[:, None])
    solved = cv2.undistortPointsIter(points, np.eye(3), np.array(coefficients), np.eye(3), np.eye(3), _CRITERIA)
    return np.asarray(solved, np.float64)[:, 0].T.reshape(x.shape)
