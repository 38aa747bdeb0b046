"""Lenses: pinhole intrinsics with distortion, rays of pixels, undistortion, and registration of depth to colour."""

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
COARSE = 24
"""Steps along each edge of the image in which a lens is looked at as a whole."""
_PROFILE = 1000
_OUTSIDE = -16.0


class LensModel(StrEnum):
    """What the coefficients of a lens mean.

    NONE: there is no distortion. UNKNOWN: the driver does not tell, and pixels are taken for a pinhole camera's.
    BROWN_CONRADY: OpenCV's model, k1 k2 p1 p2 k3 (k4 k5 k6), from the true direction to the one in the image.
    MODIFIED_BROWN_CONRADY: librealsense's, k1 k2 p1 p2 k3, with the tangential terms of the radially distorted
    direction.
    """

    NONE = "none"
    UNKNOWN = "unknown"
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
        return self.known and self.model is not LensModel.NONE and any(self.coefficients)

    @property
    def known(self) -> bool:
        """Whether its distortion is known, or that it has none."""
        return self.model is not LensModel.UNKNOWN

    def largest_displacement(self) -> float:
        """How far a pixel is from where a pinhole camera with the same intrinsics would have it, at most [px].

        Raises:
            NotReadyError: The coefficients are no lens's.
        """
        return self.largest_difference(Lens(self.intrinsics))

    def largest_difference(self, other: Lens) -> float:
        """How far two lenses differ.

        Args:
            other: Another lens, of images of the same size.

        Returns:
            Largest distance of the places of one pixel's two directions in a pinhole image [px].

        Raises:
            NotReadyError: The coefficients are no lens's.
        """
        k = self.intrinsics
        u, v = np.meshgrid(np.linspace(0, k.width - 1, COARSE + 1), np.linspace(0, k.height - 1, COARSE + 1))
        off = self._directions(u, v) - other._directions(u, v)
        return float(np.hypot(k.fx * off[0], k.fy * off[1]).max())

    def rays(self) -> NDArray[np.float32]:
        """Directions of the pixels.

        Returns:
            x and y of each pixel's direction at z = 1, (2, H, W), in the camera's frame.

        Raises:
            NotReadyError: The coefficients are no lens's.
        """
        return self._directions(*self._pixels()).astype(np.float32)

    def distort(self, rays: Array) -> Array:
        """Project directions, the other way round than `rays`.

        Args:
            rays: x and y of true directions at z = 1, (2, ...), in the camera's frame.

        Returns:
            Their pixels u and v in the image, (2, ...).
        """
        k = self.intrinsics
        x, y = self._distorted(rays) if self.distorts else rays
        return np.stack([x * k.fx + k.cx, y * k.fy + k.cy])

    def undistortion(self) -> Undistortion:
        """The map from this lens's image to that of a pinhole camera with the same intrinsics.

        Raises:
            NotReadyError: The coefficients are no lens's.
        """
        self.largest_displacement()
        u, v = self._pixels()
        k = self.intrinsics
        true = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy])
        x, y = self.distort(true).astype(np.float32)
        # Where the polynomial turns back, far outside of the image that determined it, it tells nothing.
        unknown = np.hypot(*true) >= self._reach(float(np.hypot(*true).max()))
        x[unknown] = y[unknown] = _OUTSIDE
        coarse, fine = cv2.convertMaps(x, y, cv2.CV_16SC2)
        nearest, _ = cv2.convertMaps(x, y, cv2.CV_16SC2, nninterpolation=True)
        return Undistortion(coarse, fine, nearest)

    def _pixels(self) -> tuple[Array, Array]:
        k = self.intrinsics
        u, v = np.meshgrid(np.arange(k.width, dtype=np.float64), np.arange(k.height, dtype=np.float64))
        return u, v

    def _directions(self, u: Array, v: Array) -> Array:
        k = self.intrinsics
        image = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy])
        return self._solved(image) if self.distorts else image

    def _reach(self, farthest: float) -> float:
        """Distance from the axis at z = 1 up to which the distorted distance grows with the true one."""
        r = np.linspace(0.0, farthest, _PROFILE)
        if not self.distorts:
            return np.inf
        falls = np.flatnonzero(np.diff(r * self._radial(r * r)) <= 0)
        return float(r[falls[0]]) if falls.size else np.inf

    def _radial(self, r2: Array) -> Array:
        """Factor on the distance from the axis, of its square at z = 1."""
        k1, k2, _, _, k3, k4, k5, k6 = self._eight
        radial: Array = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return radial

    @property
    def _eight(self) -> tuple[float, ...]:
        return (*self.coefficients, *(0.0,) * (8 - len(self.coefficients)))

    def _distorted(self, x: Array) -> Array:
        """Directions in the image of true directions, (2, ...) at z = 1."""
        p1, p2 = self._eight[2:4]
        a, b = x
        r2 = a * a + b * b
        radial = self._radial(r2)
        c, d = (a * radial, b * radial) if self.model is LensModel.MODIFIED_BROWN_CONRADY else (a, b)
        return np.stack(
            [
                a * radial + 2 * p1 * c * d + p2 * (r2 + 2 * c * c),
                b * radial + p1 * (r2 + 2 * d * d) + 2 * p2 * c * d,
            ]
        )

    def _solved(self, image: Array) -> Array:
        """True directions of directions in the image, (2, ...) at z = 1, by fixed-point iteration."""
        true = image.copy()
        with np.errstate(over="ignore", invalid="ignore"):  # where it does not converge
            for _ in range(ITERATIONS):
                off = image - self._distorted(true)
                true += off
                if np.abs(off).max() < PRECISION / self.intrinsics.fx:
                    return true
        message = "the distortion coefficients are wrong: pixels of this lens would have no direction"
        raise NotReadyError(message, code="not_ready.camera_lens")


@dataclass(frozen=True)
class Undistortion:
    """Maps that undistort images of one lens; see `Lens.undistortion`."""

    coarse: NDArray[Any]
    """OpenCV's fixed-point map, whole pixels, (H, W, 2)."""
    fine: NDArray[Any]
    """OpenCV's fixed-point map, fractions, (H, W)."""
    nearest: NDArray[Any]
    """OpenCV's fixed-point map to the nearest pixel, (H, W, 2)."""

    def color(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Undistort a colour image.

        Args:
            rgb: The image, (H, W, 3).

        Returns:
            The image of the pinhole camera, (H, W, 3), interpolated linearly; black outside.
        """
        return np.asarray(cv2.remap(rgb, self.coarse, self.fine, cv2.INTER_LINEAR), np.uint8)

    def depth(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Undistort a depth image that was taken through the same lens.

        Args:
            depth: The image, (H, W) [m]; 0 where unknown.

        Returns:
            The image of the pinhole camera, (H, W) [m]: the nearest pixel's depth, so that none arises between two
            surfaces; 0 where it is unknown, and outside.
        """
        nearest = cv2.remap(depth, self.nearest, None, cv2.INTER_NEAREST)  # type: ignore[call-overload]
        return np.asarray(nearest, np.float32)


MARGIN = 1.2
"""Size of a depth pixel's footprint in the colour image, relative to its projection. Above 1, so that surfaces that the
colour camera sees less obliquely than the depth camera get no cracks; it widens edges by a tenth of a pixel."""


class DepthRegistration:
    """Registers depth images to an undistorted colour image.

    Each depth pixel is projected into the colour camera and gives its depth to the pixels whose centres lie in its
    footprint; where several do, the nearest surface wins (a z-buffer). The depth in the colour camera is that along its
    own optical axis.

    Args:
        depth: Lens of the depth camera.
        color: Pinhole model of the undistorted colour image.
        X_color_depth: Pose of the depth camera in the colour camera, (4, 4) [m].
    """

    def __init__(self, depth: Lens, color: CameraIntrinsics, X_color_depth: Array) -> None:
        R, t = X_color_depth[:3, :3], X_color_depth[:3, 3]
        x, y = depth.rays().reshape(2, -1).astype(np.float64)
        rays = R @ np.stack([x, y, np.ones_like(x)])
        # Of fx * X + cx * Z and its like, so that a division by Z gives the pixel.
        self._u = (color.fx * rays[0] + color.cx * rays[2]).astype(np.float32)
        self._v = (color.fy * rays[1] + color.cy * rays[2]).astype(np.float32)
        self._z = rays[2].astype(np.float32)
        self._offset = np.array(
            [color.fx * t[0] + color.cx * t[2], color.fy * t[1] + color.cy * t[2], t[2]], np.float32
        )
        self._half = (
            np.float32(0.5 * MARGIN * color.fx / depth.intrinsics.fx),
            np.float32(0.5 * MARGIN * color.fy / depth.intrinsics.fy),
        )
        self._shape = (color.height, color.width)

    def __call__(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Register a depth image.

        Args:
            depth: Depth along the depth camera's axis, (h, w) [m]; 0 or NaN where unknown.

        Returns:
            Depth along the colour camera's axis, (H, W) [m]; 0 where unknown.
        """
        height, width = self._shape
        d = depth.reshape(-1)
        d, u, v, z = self._of(np.flatnonzero((d > 0) & (d < np.inf)), d, self._u, self._v, self._z)
        z = z * d + self._offset[2]
        if not np.all(z > 0):
            d, u, v, z = self._of(np.flatnonzero(z > 0), d, u, v, z)
        inverse = 1 / z
        u = (u * d + self._offset[0]) * inverse
        v = (v * d + self._offset[1]) * inverse
        half_u, half_v = self._half
        # A border around the image takes what falls outside, so that nothing has to be sorted out before.
        border = 1 + int(np.ceil(2 * max(half_u, half_v)))
        stride = width + 2 * border
        buffer = np.full((height + 2 * border) * stride, np.inf, np.float32)
        first_u, last_u = np.ceil(u - half_u), np.floor(u + half_u)
        first_v, last_v = np.ceil(v - half_v), np.floor(v + half_v)
        np.clip(first_u, -border, width, out=first_u)
        np.clip(first_v, -border, height, out=first_v)
        cell = ((first_v + border) * stride + (first_u + border)).astype(np.intp)
        columns = (last_u - first_u).astype(np.int8)
        rows = (last_v - first_v).astype(np.int8)
        most_u, most_v = int(np.ceil(2 * half_u)), int(np.ceil(2 * half_v))
        for dv in range(most_v + 1):
            for du in range(most_u + 1):
                covered = (columns >= du) & (rows >= dv)
                if du == dv == 0 and covered.all():
                    np.minimum.at(buffer, cell, z)
                else:
                    np.minimum.at(buffer, cell[covered] + (dv * stride + du), z[covered])
        image = buffer.reshape(-1, stride)[border : border + height, border : border + width]
        return np.where(np.isfinite(image), image, np.float32(0))

    @staticmethod
    def _of(chosen: NDArray[np.intp], *values: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
        return values if len(chosen) == len(values[0]) else tuple(value[chosen] for value in values)
