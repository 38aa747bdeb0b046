"""Frame names and the SE(3) functions of the project.

Monogram notation: `X_AB` is the pose of frame B in frame A, a 4x4 float64 array, so inner letters cancel:
`X_base_ee = X_base_camera @ X_camera_ee`. SI units, radians, quaternions xyzw.

- `base`: the robot description's `base_link`, half a turn about z from the Base of the teach pendant (`BaseFrame`).
- `flange`: UR tool0. `hand`: the palm.
- `tool`: the handle (grip centre, z from the butt to the head, x to the working side).
- `ee`: the tool's end effector, coincident with its counterpart at contact.
- `camera`: OpenCV (x right, y down, z forward). `nail`: centre of the head's top, z into the wood.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
"""A float64 array; the docstring at its use gives shape and unit."""
_IDENTITY = np.eye(4)
HALF_TURN: Array = np.diag([-1.0, -1.0, 1.0, 1.0])
"""X_baselink_pendantbase, (4, 4): half a turn about z, its own inverse."""


class BaseFrame(StrEnum):
    """The two frames at an arm's base in which a person gives or reads a position.

    BASE_LINK: the `base` of this project and of ROS. PENDANT_BASE: the feature Base of a UR's teach pendant, in which
    its Move screen and RTDE tell the TCP.
    """

    BASE_LINK = "base_link"
    PENDANT_BASE = "pendant_base"

    @property
    def X_base_this(self) -> Array:
        """Pose of this frame in `base`, (4, 4)."""
        return (HALF_TURN if self is BaseFrame.PENDANT_BASE else _IDENTITY).copy()


def is_rigid(X: Array, tolerance: float = 1e-6) -> bool:
    """Whether an array is a rigid transform: finite, orthonormal, right-handed, with the last row 0 0 0 1.

    Args:
        X: The array, (4, 4).
        tolerance: Largest absolute deviation of every element.
    """
    if not np.all(np.isfinite(X)):
        return False
    R = X[:3, :3]
    return bool(
        np.allclose(R @ R.T, np.eye(3), atol=tolerance)
        and np.linalg.det(R) > 0
        and np.allclose(X[3], [0, 0, 0, 1], atol=tolerance)
    )


def transform(R: Any = None, p: Any = None) -> Array:
    """Build a pose from a rotation and a position.

    Args:
        R: Rotation, (3, 3) array or scipy Rotation; the identity if None.
        p: Position, (3,) [m]; zero if None.

    Returns:
        The pose, (4, 4).
    """
    X = _IDENTITY.copy()
    if R is not None:
        X[:3, :3] = R.as_matrix() if isinstance(R, Rotation) else np.asarray(R, dtype=np.float64)
    if p is not None:
        X[:3, 3] = np.asarray(p, dtype=np.float64)
    return X


def rotation_z(angle: float) -> Array:
    """Rotation about z, bit-identical to scipy's `Rotation.from_euler("z", angle)` in a tenth of its time.

    Args:
        angle: Angle [rad].

    Returns:
        The rotation, (3, 3).
    """
    z, w = math.sin(0.5 * angle), math.cos(0.5 * angle)
    c, s = w * w - z * z, 2.0 * (z * w)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, z * z + w * w]])


def random_rotation(rng: np.random.Generator) -> Array:
    """Draw a uniformly distributed rotation, bit-identical to scipy's `Rotation.random` in a sixth of its time.

    Args:
        rng: Source of the four normal deviates that it uses.

    Returns:
        The rotation, (3, 3).
    """
    x, y, z, w = rng.normal(size=4).tolist()
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    return np.array(
        [
            [xx - yy - zz + ww, 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), -xx + yy - zz + ww, 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), -xx - yy + zz + ww],
        ]
    )


def inverse(X: Array) -> Array:
    """Invert rigid transforms X, (..., 4, 4)."""
    if X.ndim == 2:  # the usual case, called in every step of a simulation
        R_t = X[:3, :3].T
        Y = np.zeros((4, 4))
        Y[:3, :3] = R_t
        Y[:3, 3] = (-R_t).dot(X[:3, 3])
        Y[3, 3] = 1.0
        return Y
    R_t = np.swapaxes(X[..., :3, :3], -1, -2)
    Y = np.zeros_like(X)
    Y[..., :3, :3] = R_t
    Y[..., :3, 3:] = -R_t @ X[..., :3, 3:]
    Y[..., 3, 3] = 1.0
    return Y


def transform_points(X: Array, points: Array) -> Array:
    """Express points in another frame.

    Args:
        X: X_AB, (..., 4, 4).
        points: Points in frame B, (..., N, 3) [m].

    Returns:
        The points in frame A, (..., N, 3) [m].
    """
    return points @ np.swapaxes(X[..., :3, :3], -1, -2) + X[..., None, :3, 3]


def rotation_angle(R: Array) -> float:
    """Angle [rad] of a rotation R, (3, 3), accurate near 0 and pi."""
    return float(np.linalg.norm(Rotation.from_matrix(R).as_rotvec()))


def angle_between(a: Array, b: Array) -> float:
    """Angle between two vectors, accurate near 0 and pi.

    Args:
        a: A vector, (3,), of any length but 0.
        b: The other vector, (3,).

    Returns:
        The angle in [0, pi] [rad].
    """
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b)))


def cross(a: Array | Sequence[float], b: Array | Sequence[float]) -> Array:
    """Cross product of two vectors, in a twentieth of the time of np.cross.

    Args:
        a: The first vector, (3,).
        b: The second vector, (3,).

    Returns:
        a x b, (3,).
    """
    # Python's floats: arithmetic with numpy's takes several times as long.
    ax, ay, az = a.tolist() if isinstance(a, np.ndarray) else a
    bx, by, bz = b.tolist() if isinstance(b, np.ndarray) else b
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def skew(v: Array) -> Array:
    """Matrices of the cross product with vectors.

    Args:
        v: Vectors, (..., 3).

    Returns:
        S with S @ b = v x b, (..., 3, 3).
    """
    S = np.zeros((*v.shape, 3))
    S[..., 0, 1], S[..., 0, 2], S[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    S[..., 1, 0], S[..., 2, 0], S[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return S


def frame_from_axes(*, z: Array, x: Array, p: Any = None) -> Array:
    """Build a pose from the directions of its z and x axes.

    Args:
        z: Direction of the z axis, (3,), any length.
        x: Direction whose component orthogonal to z is the x axis, (3,), any length.
        p: Position, (3,) [m]; zero if None.

    Returns:
        The pose, (4, 4).

    Raises:
        ValueError: x and z are parallel.
    """
    e_z = np.asarray(z, dtype=np.float64) / np.linalg.norm(z)
    e_x = np.asarray(x, dtype=np.float64) - np.dot(x, e_z) * e_z
    norm = np.linalg.norm(e_x)
    if norm < 1e-9:
        raise ValueError("x and z are parallel: they do not define a frame")
    e_x = e_x / norm
    return transform(np.column_stack([e_x, np.cross(e_z, e_x), e_z]), p)
