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
_NEAR = 0.2
"""Share of points within twice `SURFACE` of the tool, but not on it, from which on its depth is in doubt: 2 % of a long
screwdriver's are there, 16 % in the noisiest image."""
_JITTER = 2
"""Most pixels' lateral noise reaches no further [px]."""


def is_thin(mask: NDArray[np.bool_]) -> bool:
    """Whether nearly all of it is within the sensor's jitter of its outline."""
    return int(np.count_nonzero(binary_erosion(mask, iterations=_JITTER))) < ENOUGH


def pose_fault(
    points: Array, within: NDArray[np.bool_], X_camera_tool: Array, surface: cKDTree, K: CameraIntrinsics, thin: bool
) -> str | None:
    """Check the pose of a tool against the measured points of an EE.

    Flying pixels and background may be a third of the points of a thin tool, and half of those of a long screwdriver's
    shaft. So half of the points must lie on the tool; or three tenths, if all others lie behind or before the tool's
    outline, and, unless the mask is thin, far: beside a pose that is off in depth they lie near. Points on the tool
    must be within the EE's reach, unless the EE is so thin that lateral noise shows other parts of the tool.

    Args:
        points: Measured points of the EE's mask, camera frame, (N, 3) [m].
        within: Which of them are within the EE's reach, (N,).
        X_camera_tool: The pose to check, (4, 4).
        surface: Samples of the tool's surface, `tool` frame [m].
        K: Intrinsics of the camera.
        thin: Whether lateral noise affects nearly the whole mask, see `is_thin`.

    Returns:
        What shows that the pose is wrong; None where nothing does.
    """
    distance = surface.query(transform_points(inverse(X_camera_tool), points))[0]
    on_tool = distance < SURFACE
    if (share := on_tool.mean()) < 0.5:
        outlined = _beyond_outline(points, transform_points(X_camera_tool, np.asarray(surface.data)), K)
        far = ((distance >= SURFACE) & (distance < 2 * SURFACE)).mean() < _NEAR
        if not ((thin or far) and share > 0.3 and (on_tool | outlined).mean() > 0.98):
            return f"{share:.0%} of its points are on the tool"
    if (share := within[on_tool].mean()) < (0.5 if thin else 0.9):
        return f"{share:.0%} of its points are in the EE's reach"
    return None


def _beyond_outline(points: Array, surface: Array, K: CameraIntrinsics) -> NDArray[np.bool_]:
    """Which points lie behind or before the surface, within lateral noise of its outline.

    Args:
        points: Points, camera frame, (N, 3) [m].
        surface: Samples of the surface, camera frame, (S, 3) [m].
        K: Intrinsics of the camera.
    """

    def pixels(x: Array) -> Array:
        return np.column_stack([K.fx * x[:, 0], K.fy * x[:, 1]]) / x[:, 2:]

    distance, nearest = cKDTree(pixels(surface)).query(pixels(points))
    return np.asarray((distance <= _JITTER + 0.5) & (np.abs(points[:, 2] - surface[nearest, 2]) > SURFACE))
