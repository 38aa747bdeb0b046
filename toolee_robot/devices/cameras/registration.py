"""Registration of a depth image to the colour image of a camera beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolee_robot.devices.cameras.lens import Lens
from toolee_robot.frames import Array
from toolee_robot.types import CameraIntrinsics

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
