"""Does an end effector's pose fit the points that a noisy camera sees of it?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.types import CameraIntrinsics

SURFACE = 0.008
"""Farther [m] from the tool's surface no point is the tool's: noise is 3 mm at most in the median."""
ENOUGH = 100
"""Fewer points than this tell nothing."""
_JITTER = 2
"""Most pixels' lateral noise reaches no further [px]."""


def is_thin(mask: NDArray[np.bool_]) -> bool:
    """Whether nearly all of it is within the sensor's jitter of its outline."""
    return int(np.count_nonzero(binary_erosion(mask, iterations=_JITTER))) < ENOUGH


def pose_fault(
    points: Array, within: NDArray[np.bool_], X_camera_tool: Array, surface: cKDTree, K: CameraIntrinsics, thin: bool
) -> str | None:
    """What shows that the pose is wrong, or None. points (N, 3) [m]: a mask's, camera frame; within (N,): which of them
    the EE reaches; surface: samples of the tool's, in its frame [m]; thin: whether jitter moves nearly all of the mask.

    Flying pixels and those of the background may be a third of a thin tool's, so half must lie on it, of the thinnest
    three tenths, where all others show what is behind or before its outline. What lies on the tool lies within the EE,
    unless it is so thin that jitter reaches past it to the tool behind.
    """
    on_tool = surface.query(transform_points(inverse(X_camera_tool), points))[0] < SURFACE
    if (share := on_tool.mean()) < 0.5:
        outlined = _beyond_outline(points, transform_points(X_camera_tool, np.asarray(surface.data)), K)
        if not (thin and share > 0.3 and (on_tool | outlined).mean() > 0.98):
            return f"{share:.0%} of its points are on the tool"
    if (share := within[on_tool].mean()) < (0.5 if thin else 0.9):
        return f"{share:.0%} of its points are in the EE's reach"
    return None


def _beyond_outline(points: Array, surface: Array, K: CameraIntrinsics) -> NDArray[np.bool_]:
    """Which points (N, 3) lie behind or before the surface of samples (S, 3), where jitter may take its outline; camera
    frame [m]."""

    def pixels(x: Array) -> Array:
        return np.column_stack([K.fx * x[:, 0], K.fy * x[:, 1]]) / x[:, 2:]

    distance, nearest = cKDTree(pixels(surface)).query(pixels(points))
    return np.asarray((distance <= _JITTER + 0.5) & (np.abs(points[:, 2] - surface[nearest, 2]) > SURFACE))
