"""Poses and their uncertainty as a person reads them."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array


def pose_text(X: Array) -> str:
    """Position in mm and rotation vector in degrees, for a person; "unknown" for a pose that is not finite."""
    if not np.all(np.isfinite(X)):
        return "unknown"
    x, y, z = X[:3, 3] * 1e3
    a, b, c = np.rad2deg(Rotation.from_matrix(X[:3, :3]).as_rotvec())
    return f"({x:+.1f}, {y:+.1f}, {z:+.1f}) mm  ({a:+.1f}, {b:+.1f}, {c:+.1f})°"


def sigma_text(covariance: Array, X: Array) -> str:
    """Standard deviations of a pose (4x4) with a 6x6 covariance, in mm and degrees: the largest of the position, of the
    direction of the z axis, and of the spin about it; a free spin is called that."""
    if not (np.all(np.isfinite(covariance)) and np.all(np.isfinite(X))):
        return "unknown"
    position = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:3, :3])[-1]), 0.0)) * 1e3
    z = X[:3, 2]
    across = np.eye(3) - np.outer(z, z)
    rotation = covariance[3:, 3:]
    axis = np.rad2deg(math.sqrt(max(float(np.linalg.eigvalsh(across @ rotation @ across)[-1]), 0.0)))
    spin = np.rad2deg(math.sqrt(max(float(z @ rotation @ z), 0.0)))
    # Uniform over a turn: 104 degrees.
    return f"± {position:.1f} mm  axis ± {axis:.1f}°  spin " + ("free" if spin > 60.0 else f"± {spin:.0f}°")
