"""Rotation functions that pooling needs, in closed form: scipy's cost tens of microseconds per call."""

from __future__ import annotations

import math

import numpy as np

from toolee_robot.frames import Array


def rotation_matrix(w: Array) -> Array:
    """The rotation (3, 3) of a rotation vector w (3,) [rad]."""
    x, y, z = w.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    if angle == 0:
        return np.eye(3)
    x, y, z = x / angle, y / angle, z / angle
    s, k = math.sin(angle), 2 * math.sin(angle / 2) ** 2
    return np.array(
        [
            [1 - k * (y * y + z * z), k * x * y - s * z, k * x * z + s * y],
            [k * x * y + s * z, 1 - k * (x * x + z * z), k * y * z - s * x],
            [k * x * z - s * y, k * y * z + s * x, 1 - k * (x * x + y * y)],
        ]
    )


def rotations_about(axis: Array, angle: Array) -> Array:
    """Rotations about an axis, by Rodrigues' formula.

    Args:
        axis: The axis, a unit vector, (3,).
        angle: Angles [rad], (K,).

    Returns:
        The rotations, (K, 3, 3).
    """
    x, y, z = axis.tolist()
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    along = axis[:, None] * axis
    c, s = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    return along + c * (np.eye(3) - along) + s * across


def rotation_vectors(R: Array) -> Array:
    """Rotation vectors (K, 3) [rad] of rotations (K, 3, 3) by less than about half a turn."""
    twice, trace = _axis_and_trace(R)
    # Bounded below, so that the identity does not give 0 / 0.
    sine = np.maximum(0.5 * np.sqrt(np.vecdot(twice, twice)), 1e-30)
    return twice * (0.5 * np.arctan2(sine, 0.5 * (trace - 1)) / sine)[:, None]


def twist_angles(R: Array, axis: Array) -> Array:
    """Twist of rotations about an axis: the angle of the twist in R = swing @ twist.

    Args:
        R: Rotations, (K, 3, 3).
        axis: The axis, a unit vector, (3,).

    Returns:
        The angles [rad], (K,).
    """
    # By the quaternion (v, w) of R these are 4 w (v . axis) and 2 (w^2 - (v . axis)^2), so that the angle is
    # 2 atan2(v . axis, w).
    twice, trace = _axis_and_trace(R)
    return np.arctan2(twice @ axis, trace - (R @ axis) @ axis)


_SUMS = np.zeros((9, 4))
_SUMS[[7, 2, 3], [0, 1, 2]], _SUMS[[5, 6, 1], [0, 1, 2]], _SUMS[[0, 4, 8], 3] = 1.0, -1.0, 1.0


def _axis_and_trace(R: Array) -> tuple[Array, Array]:
    """Of rotations (K, 3, 3): the axis times twice the sine of the angle (K, 3), and the trace (K,)."""
    sums = R.reshape(-1, 9) @ _SUMS
    return sums[:, :3], sums[:, 3]
