"""Poses and their uncertainty as a person reads them."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array


def pose_text(X: Array) -> str:
    """Format a pose, (4, 4), as position in mm and rotation vector in degrees; "unknown" if it is not finite."""
    if not np.all(np.isfinite(X)):
        return "unknown"
    x, y, z = X[:3, 3] * 1e3
    a, b, c = np.rad2deg(Rotation.from_matrix(X[:3, :3]).as_rotvec())
    return f"({x:+.1f}, {y:+.1f}, {z:+.1f}) mm  ({a:+.1f}, {b:+.1f}, {c:+.1f})°"


def sigma_text(covariance: Array, X: Array) -> str:
    """Format the standard deviations of a pose in mm and degrees.

    Args:
        covariance: Covariance of position [m] and rotation vector [rad], (6, 6).
        X: The pose, (4, 4).

    Returns:
        The largest standard deviation of the position, of the z axis' direction, and of the spin about it ("free" for
        an unobserved spin).
    """
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
