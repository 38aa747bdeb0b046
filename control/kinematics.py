"""Forward kinematics and Jacobians of a six-joint arm, for many configurations at once.

A Pinocchio model evaluates one configuration in microseconds, but a strike plan needs thousands of them: the sweep of
the spin, eight branches, every point of the run-up. This module reads the joints' placements and axes from the
Pinocchio model once and evaluates the same kinematics in NumPy batches.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from toolee_robot.frames import Array


class ArmKinematics:
    """Kinematics of a chain of six revolute joints from `base` to `flange`.

    Args:
        placements: Pose of each joint in the previous one, the first in `base`, (6, 4, 4).
        axes: Axis of each joint in its own frame, unit vectors, (6, 3).
        X_joint6_flange: Pose of the flange in the last joint, (4, 4).
        lower: Lower position limits, (6,) [rad].
        upper: Upper position limits, (6,) [rad].
    """

    def __init__(self, placements: Array, axes: Array, X_joint6_flange: Array, lower: Array, upper: Array) -> None:
        self.placements = placements
        self.axes = axes
        self.X_joint6_flange = X_joint6_flange
        self.lower = lower
        self.upper = upper
        # Rodrigues' formula, R = I + sin(q) K + (1 - cos(q)) K^2, with the placement already multiplied in.
        K = np.zeros((6, 3, 3))
        K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -axes[:, 2], axes[:, 1], -axes[:, 0]
        K -= np.swapaxes(K, 1, 2)
        R = placements[:, :3, :3]
        self._constant, self._sine, self._cosine = R + R @ K @ K, R @ K, -R @ K @ K
        self._offset = placements[:, :3, 3]

    @classmethod
    def from_pinocchio(cls, model: Any, flange: str, X_base_root: Array) -> ArmKinematics:
        """Read the chain from a Pinocchio model whose first six joints are the arm.

        Args:
            model: The Pinocchio model.
            flange: Name of the flange's frame.
            X_base_root: Pose of the model's root in `base`, (4, 4).

        Returns:
            The chain, with the position limits of the model.

        Raises:
            ValueError: The flange is not attached to the arm's last joint.
        """
        placements = np.stack([model.jointPlacements[j].homogeneous for j in range(1, 7)])
        placements[0] = X_base_root @ placements[0]
        named = {"JointModelRX": [1.0, 0, 0], "JointModelRY": [0, 1.0, 0], "JointModelRZ": [0, 0, 1.0]}
        axes = np.array([named[model.joints[j].shortname()] for j in range(1, 7)])
        frame = model.frames[model.getFrameId(flange)]
        if frame.parentJoint != 6:
            raise ValueError(f"frame {flange!r} hangs on joint {frame.parentJoint}, not on the arm's last joint")
        lower, upper = model.lowerPositionLimit[:6].copy(), model.upperPositionLimit[:6].copy()
        return cls(placements, axes, frame.placement.homogeneous, lower, upper)

    def joints(self, q: Array) -> tuple[Array, Array]:
        """Compute the pose of every joint's frame in `base`.

        Args:
            q: Joint positions, (..., 6) [rad].

        Returns:
            Rotations, (..., 6, 3, 3), and origins, (..., 6, 3) [m].
        """
        c, s = np.cos(q)[..., None, None], np.sin(q)[..., None, None]
        local = self._constant + s * self._sine + c * self._cosine
        R = np.empty_like(local)
        p = np.empty(local.shape[:-1])
        R[..., 0, :, :], p[..., 0, :] = local[..., 0, :, :], self._offset[0]
        for i in range(1, 6):
            p[..., i, :] = p[..., i - 1, :] + R[..., i - 1, :, :] @ self._offset[i]
            R[..., i, :, :] = R[..., i - 1, :, :] @ local[..., i, :, :]
        return R, p

    def fk(self, q: Array) -> Array:
        """Compute X_base_flange, (..., 4, 4), for joint positions q, (..., 6) [rad]."""
        R, p = self.joints(q)
        return self._flange(R[..., 5, :, :], p[..., 5, :])

    def fk_jacobian(self, q: Array) -> tuple[Array, Array]:
        """Compute the forward kinematics and the geometric Jacobian.

        Args:
            q: Joint positions, (..., 6) [rad].

        Returns:
            X_base_flange, (..., 4, 4), and J, (..., 6, 6), whose rows are the linear velocity of the flange's origin
            [m/s] and the angular velocity [rad/s], both in `base` axes.
        """
        R, p = self.joints(q)
        X = self._flange(R[..., 5, :, :], p[..., 5, :])
        axes = np.einsum("...ijk,ik->...ij", R, self.axes)
        arm = X[..., None, :3, 3] - p
        J = np.concatenate([np.cross(axes, arm), axes], axis=-1)
        return X, np.swapaxes(J, -1, -2)

    def _flange(self, R: Array, p: Array) -> Array:
        X = np.zeros((*p.shape[:-1], 4, 4))
        X[..., :3, :3] = R @ self.X_joint6_flange[:3, :3]
        X[..., :3, 3] = p + R @ self.X_joint6_flange[:3, 3]
        X[..., 3, 3] = 1.0
        return X


def solve(J: Array, v: Array) -> Array:
    """Solve J x = v, slightly damped so that a singular configuration gives large but finite rates.

    Args:
        J: Jacobians, (..., 6, 6).
        v: Velocities, (..., 6).

    Returns:
        Joint rates, (..., 6).
    """
    Jt = np.swapaxes(J, -1, -2)
    A = Jt @ J + 1e-12 * np.eye(6)
    return np.asarray(np.linalg.solve(A, Jt @ v[..., None])[..., 0], dtype=np.float64)


def smallest_singular_value(J: Array) -> Array:
    """Smallest singular values, (...), of Jacobians J, (..., 6, 6), in metres and radians; 0 at a singularity."""
    return np.asarray(np.linalg.svd(J, compute_uv=False)[..., -1], dtype=np.float64)
