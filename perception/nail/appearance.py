"""What a nail looks like: its shank and head as a camera covers them, and how well an image agrees.

A nail is some pixels high and one wide, so that pixels are covered in part. The brightness of what is around it, and at
first of its two parts, is unknown and follows by linear least squares: a fit needs no model of lamps, steel and wood.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array, transform_points
from toolee_robot.types import CameraIntrinsics

SUBPIXELS = 8
"""Number of subpixels along a pixel's edge that a coverage is counted by."""
FIXED = 4
"""Bits after the point of the polygons' corners, in subpixels."""
RIM = np.linspace(0.0, 2.0 * np.pi, 17)[:-1]
"""Angles at which the circles of shank and head are sampled [rad]."""
HEAD_THICKNESS = 0.001
"""Thickness of a nail's head [m]."""


@dataclass(frozen=True, eq=False)
class NailPose:
    """Where a nail stands.

    Attributes:
        foot: Where its axis enters the wood, `base`, (3,) [m].
        head: Middle of its head's top, `base`, (3,) [m].
    """

    foot: Array
    head: Array


@dataclass(frozen=True)
class Window:
    """A part of an image.

    Attributes:
        left: First column.
        top: First row.
        right: First column beyond it.
        bottom: First row beyond it.
    """

    left: int
    top: int
    right: int
    bottom: int

    def cut(self, image: NDArray[Any]) -> NDArray[Any]:
        """The part of an image, (H, W) or (H, W, n)."""
        return image[self.top : self.bottom, self.left : self.right]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.bottom - self.top, self.right - self.left

    @property
    def plane(self) -> Array:
        """A plane of brightness in its pixels: one, and how far right and down of the middle they are, (h * w, 3)."""
        rows, columns = np.indices(self.shape, dtype=float)
        parts = [np.ones(self.shape), columns - columns.mean(), rows - rows.mean()]
        return np.asarray(np.stack([part.ravel() for part in parts], axis=1), float)


@dataclass(frozen=True, eq=False)
class Comparison:
    """How a part of an image compares with a nail.

    Attributes:
        residuals: Differences from the closest picture of a nail, (m * n,) for m pixels.
        without: Differences from the closest picture without one, (m * n,).
        colours: How much brighter than what is around them shank and head are, (2, n).
    """

    residuals: Array
    without: Array
    colours: Array

    @property
    def left(self) -> float:
        """Mean square that the nail leaves unexplained."""
        return float(np.mean(self.residuals**2))

    @property
    def explained(self) -> float:
        """Share of the variance that is the nail."""
        variance = float(np.mean(self.without**2))
        return 1.0 - self.left / variance if variance else 0.0


class Appearance:
    """A nail in a camera's image.

    Args:
        intrinsics: Pinhole model of the image.
        X_camera_base: Pose of `base` in the camera frame, (4, 4).
        radius: Radius of the shank [m].
        head_radius: Radius of the head [m].
        blur: Standard deviation of the camera's blur [pixel].

    Attributes:
        head_radius: Radius of the head [m].
    """

    def __init__(
        self, intrinsics: CameraIntrinsics, X_camera_base: Array, radius: float, head_radius: float, blur: float
    ) -> None:
        self._intrinsics, self._X_camera_base = intrinsics, X_camera_base
        self._radius, self.head_radius, self._blur = radius, head_radius, blur

    def pixels(self, points: Array) -> Array:
        """Project points.

        Args:
            points: In `base`, (N, 3) [m].

        Returns:
            Their pixels, (N, 2), in which whole numbers are the middles of pixels.
        """
        return self._intrinsics.project(transform_points(self._X_camera_base, points))

    def scale(self, point: Array) -> float:
        """How many pixels a metre across the optical axis is at a point in `base`, (3,) [m]."""
        return float(np.hypot(self._intrinsics.fx, self._intrinsics.fy) / np.sqrt(2.0) / self.depth(point))

    def depth(self, point: Array) -> float:
        """Depth of a point in `base`, (3,) [m], along the optical axis [m]."""
        return float(transform_points(self._X_camera_base, point[None])[0, 2])

    def window(self, pose: NailPose, margin: float) -> Window | None:
        """The part of the image around a nail.

        Args:
            pose: Where it stands.
            margin: What is to be around foot and head [pixel].

        Returns:
            The part; None where it is not all in the image.
        """
        corners = self.pixels(np.stack([pose.foot, pose.head]))
        left, top = np.floor(corners.min(axis=0) - margin).astype(int).tolist()
        right, bottom = (np.ceil(corners.max(axis=0) + margin).astype(int) + 1).tolist()
        inside = left >= 0 and top >= 0 and right <= self._intrinsics.width and bottom <= self._intrinsics.height
        return Window(left, top, right, bottom) if inside else None

    def compare(
        self,
        image: NDArray[np.float64],
        window: Window,
        pose: NailPose,
        wood: NDArray[np.bool_] | None = None,
    ) -> Comparison:
        """Compare a part of an image with a nail over a plane of brightness.

        Args:
            image: The part of the image, (h, w, n), n channels.
            window: Which part it is.
            pose: Where the nail stands.
            wood: Which of its pixels show the wood or what stands on it, (h, w); None for all. Others do not count.

        Returns:
            How they compare.
        """
        nail, around = self.covered(window, pose), window.plane
        pixels = image.reshape(len(around), -1)
        if wood is not None:
            counted = wood.ravel()
            around, nail, pixels = around[counted], nail[counted], pixels[counted]
        without = pixels - around @ np.linalg.lstsq(around, pixels, rcond=None)[0]
        A = np.hstack([around, nail])
        fitted = np.linalg.lstsq(A, pixels, rcond=None)[0]
        return Comparison((pixels - A @ fitted).ravel(), without.ravel(), np.asarray(fitted[3:], float))

    def covered(self, window: Window, pose: NailPose) -> Array:
        """How much of the pixels a nail covers.

        Args:
            window: Part of the image.
            pose: Where the nail stands.

        Returns:
            Share of each pixel that shank and head cover, (h * w, 2).
        """
        axis = (pose.head - pose.foot) / np.linalg.norm(pose.head - pose.foot)
        across = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.5 else [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across)
        rim = np.outer(np.cos(RIM), across) + np.outer(np.sin(RIM), np.cross(axis, across))
        shank = [pose.foot + self._radius * rim, pose.head + self._radius * rim]
        head = [pose.head + self.head_radius * rim, pose.head - HEAD_THICKNESS * axis + self.head_radius * rim]
        covered = self._coverage(window, np.concatenate(head))
        bare = self._coverage(window, np.concatenate(shank)) * (1.0 - covered)
        return np.stack([bare.ravel(), covered.ravel()], axis=1)

    def _coverage(self, window: Window, points: Array) -> Array:
        """Share of each pixel that the convex hull of points (N, 3) covers, blurred, (h, w)."""
        rows, columns = window.shape
        corners = (self.pixels(points) - [window.left, window.top] + 0.5) * SUBPIXELS - 0.5
        hull = cv2.convexHull(corners.astype(np.float32))[:, 0]
        mask = np.zeros((rows * SUBPIXELS, columns * SUBPIXELS), np.uint8)
        cv2.fillConvexPoly(mask, np.round(hull * 2**FIXED).astype(np.int32), 255, shift=FIXED)
        share = cv2.resize(mask, (columns, rows), interpolation=cv2.INTER_AREA).astype(float) / 255.0
        return np.asarray(cv2.GaussianBlur(share, (0, 0), self._blur), float)
