"""The part of an image in which a held tool can be, from the hand's pose: the detector looks there first.

In a job the arm's kinematics and the camera's calibration give X_camera_hand, and nothing but the tool in the hand is
of interest: the rest of the image costs time and adds what may be mistaken for it.
"""

from __future__ import annotations

import math

import numpy as np

from toolee_robot.frames import Array, transform_points
from toolee_robot.perception.detection.config import MAX_ENLARGEMENT
from toolee_robot.perception.detection.zoom_pass import Crop, span
from toolee_robot.types import CameraIntrinsics, HeldRegion

PIXELS = 320 * 320
"""Area [px] at which the network sees the crop."""


def hand_crop(
    X_camera_hand: Array, region: HeldRegion, intrinsics: CameraIntrinsics, pixels: int = PIXELS
) -> Crop | None:
    """The crop that holds everything a camera can see of a region fixed to the hand.

    Args:
        X_camera_hand: Pose of the hand in the camera's frame, (4, 4).
        region: The region.
        intrinsics: Pinhole model of the image.
        pixels: Area at which the network sees the crop [px]; it is enlarged by at most `MAX_ENLARGEMENT`.

    Returns:
        The crop; None where the region is outside of the image.
    """
    centers = transform_points(X_camera_hand, region.points)
    K = intrinsics
    x0, x1 = _extent(centers[:, 0], centers[:, 2], region.radius)
    y0, y1 = _extent(centers[:, 1], centers[:, 2], region.radius)
    # Pixel centres are at integer coordinates: the pixel u covers u - 0.5 to u + 0.5.
    left, right = (min(max(K.fx * x + K.cx + 0.5, 0.0), float(K.width)) for x in (x0, x1))
    top, bottom = (min(max(K.fy * y + K.cy + 0.5, 0.0), float(K.height)) for y in (y0, y1))
    if right - left < 1.0 or bottom - top < 1.0 or centers[:, 2].max() + region.radius <= 0.0:
        return None
    scale = min(MAX_ENLARGEMENT, math.sqrt(pixels / ((right - left) * (bottom - top))))
    first_row, last_row, height = span(top, bottom, K.height, scale)
    first_column, last_column, width = span(left, right, K.width, scale)
    return Crop(first_column, first_row, last_column, last_row, (height, width))


def _extent(across: Array, z: Array, radius: float) -> tuple[float, float]:
    """Least and largest slope across / z over discs of one radius in the plane of one image axis and the optical axis.

    A line from the camera's centre with the slope t is tangent to a disc where
    (z^2 - r^2) t^2 - 2 a z t + a^2 - r^2 = 0.

    Args:
        across: Places of the discs' centres along the image axis, (N,) [m].
        z: Their depths, (N,) [m].
        radius: Radius of the discs [m].

    Returns:
        The slopes; infinite where a disc reaches the plane of the camera.
    """
    if (z <= radius).any():
        return -math.inf, math.inf
    root = radius * np.sqrt(across**2 + z**2 - radius**2)
    denominator = z**2 - radius**2
    return float(((across * z - root) / denominator).min()), float(((across * z + root) / denominator).max())
