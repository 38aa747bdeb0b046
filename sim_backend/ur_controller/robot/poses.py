"""Poses as in URScript: six numbers, position [m] and rotation vector [rad]."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, hypot, sin, sqrt

import numpy as np

from toolee_robot.frames import Array

Vector = Sequence[float] | Array
"""Six numbers, or three where stated."""


def rotation(v: Vector) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,) [rad]."""
    x, y, z = float(v[0]), float(v[1]), float(v[2])
    angle = sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
    x, y, z = x / angle, y / angle, z / angle
    s, c = sin(angle), cos(angle)
    t = 1.0 - c
    return np.array(
        [
            [c + t * x * x, t * x * y - s * z, t * x * z + s * y],
            [t * x * y + s * z, c + t * y * y, t * y * z - s * x],
            [t * x * z - s * y, t * y * z + s * x, c + t * z * z],
        ]
    )


def rotation_vector(R: Array) -> list[float]:
    """Rotation vector (3,) [rad] of a rotation matrix (3, 3), of an angle of 0 to pi.

    Accurate for all angles, since it is computed from the quaternion.
    """
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    trace = a + e + i
    if trace > max(a, e, i):
        w, x, y, z = 1.0 + trace, h - f, c - g, d - b
    elif a >= e and a >= i:
        w, x, y, z = h - f, 1.0 + a - e - i, b + d, c + g
    elif e >= i:
        w, x, y, z = c - g, b + d, 1.0 + e - a - i, f + h
    else:
        w, x, y, z = d - b, c + g, f + h, 1.0 + i - a - e
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    length = hypot(x, y, z)
    scale = 2.0 * atan2(length, w) / length if length > 1e-15 * w else 2.0 / w
    return [x * scale, y * scale, z * scale]


def matrix(pose: Vector) -> Array:
    """The matrix X_AB, 4x4, of a pose (6,)."""
    X = np.eye(4)
    X[:3, :3] = rotation(pose[3:])
    X[:3, 3] = pose[:3]
    return X


def vector(X: Array) -> list[float]:
    """The pose (6,) of a matrix X_AB, 4x4."""
    return [*X[:3, 3].tolist(), *rotation_vector(X[:3, :3])]


def moved(X: Array, twist: Vector) -> Array:
    """Displace a pose by a twist.

    Args:
        X: The pose, (4, 4).
        twist: Translation [m] and rotation vector [rad], base axes, (6,).

    Returns:
        The displaced pose, (4, 4).
    """
    Y = X.copy()
    Y[:3, 3] += twist[:3]
    Y[:3, :3] = rotation(twist[3:]) @ X[:3, :3]
    return Y


def difference(X_from: Array, X_to: Array) -> Array:
    """The twist with which `moved` takes one pose to another.

    Args:
        X_from: The first pose, (4, 4).
        X_to: The second pose, (4, 4).

    Returns:
        Translation [m] and rotation vector [rad], base axes, (6,).
    """
    return np.array([*(X_to[:3, 3] - X_from[:3, 3]), *rotation_vector(X_to[:3, :3] @ X_from[:3, :3].T)])
