"""The pose as the network sees it: u = [Rz | Rx | S | T] in R^12.

ToolEENet represents a pose as [Rx | Ry | S | T]: two columns of the rotation (the continuous 6D representation of Zhou
et al., "On the Continuity of Rotation Representations in Neural Networks", CVPR 2019, eq. 15-16), S in R^3 whose k-th
entry marks an ambiguity about axis k, and the translation. Here the first column is the *action axis* z (the face's
normal, the shaft, the nut's axis): Gram-Schmidt keeps the first column's direction and changes the second, and on tools
that are symmetric about z, x is the ambiguous one. S is per view, not per class: a hammer's is 1 about z only where
nothing visible shows the spin.

T is in units of `T_SCALE`; rotations and T are in the canonical frame of `canonical.py`.

The rotation functions that pooling needs are in closed form: scipy's cost tens of microseconds per call.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from toolee_robot.frames import Array

DIM = 12
T_SCALE = 0.02
"""Unit [m] of T: about the standard deviation of the EE's position about the visible cloud's centre."""

AXIS_Z = slice(0, 3)
AXIS_X = slice(3, 6)
AMBIGUOUS = slice(6, 9)
POSITION = slice(9, 12)


def encode(R: Tensor, p: Tensor, ambiguous: Tensor) -> Tensor:
    """Encode poses.

    Args:
        R: Rotations (..., 3, 3).
        p: Positions (..., 3) [m].
        ambiguous: Ambiguity flags (..., 3) in {0, 1}, one per axis.

    Returns:
        u (..., 12).
    """
    return torch.cat([R[..., :, 2], R[..., :, 0], ambiguous, p / T_SCALE], dim=-1)


def decode(u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Decode poses by Gram-Schmidt, z first. Works for any u: degenerate columns fall back to a fixed direction.

    Args:
        u: (..., 12).

    Returns:
        Rotations (..., 3, 3), positions (..., 3) [m], ambiguity (..., 3).
    """
    z = _unit(u[..., AXIS_Z], u.new_tensor([0.0, 0.0, 1.0]))
    b = u[..., AXIS_X]
    x = b - (b * z).sum(-1, keepdim=True) * z
    # An arbitrary vector that is not along z, for a second column that is.
    spare = torch.nn.functional.one_hot(z.abs().argmin(-1), 3).to(z.dtype)
    spare = spare - (spare * z).sum(-1, keepdim=True) * z
    x = _unit(x, spare / spare.norm(dim=-1, keepdim=True))
    y = torch.cross(z, x, dim=-1)
    return torch.stack([x, y, z], dim=-1), u[..., POSITION] * T_SCALE, u[..., AMBIGUOUS]


def mirrored(u: Tensor) -> Tensor:
    """The pose in the view mirrored by M = diag(-1, 1, 1); its own inverse.

    A tool with a mirror plane of its own, D = diag(1, -1, 1) (hammers, claws, screwdrivers), then has the rotation M R
    D, whose z and x are M's of R's; wrenches mirror in z instead, which is the same modulo their C2 group.

    Args:
        u: (..., 12).

    Returns:
        u (..., 12) of the mirrored view.
    """
    u = u.clone()
    for part in (AXIS_Z, AXIS_X, POSITION):
        u[..., part.start].neg_()
    return u


def _unit(v: Tensor, fallback: Tensor) -> Tensor:
    norm = v.norm(dim=-1, keepdim=True)
    return torch.where(norm > 1e-6, v / norm.clamp_min(1e-6), fallback.expand_as(v))


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
