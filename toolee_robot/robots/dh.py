"""Denavit-Hartenberg parameters of the UR arms, and the URDF joint origins derived from them.

X_base_flange(q) = prod_i Rz(q_i + theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i), where `base` is the base frame of the UR
controller, `base_link` rotated by 180 degrees about z, and `flange` is `tool0`. A factory calibration adds a delta to
each parameter.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.frames import HALF_TURN, Array, inverse
from toolee_robot.types import ArmModel, DhCalibration


def dh_transform(theta: Array | float, d: float, a: float, alpha: float) -> Array:
    """Denavit-Hartenberg transforms.

    Args:
        theta: Joint angles (...,) [rad].
        d: Link offset [m].
        a: Link length [m].
        alpha: Link twist [rad].

    Returns:
        Poses (..., 4, 4) [m] of the next frame in this one.
    """
    theta = np.asarray(theta, dtype=np.float64)
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    X = np.zeros((*theta.shape, 4, 4))
    X[..., 0, 0], X[..., 0, 1], X[..., 0, 2], X[..., 0, 3] = c, -s * ca, s * sa, a * c
    X[..., 1, 0], X[..., 1, 1], X[..., 1, 2], X[..., 1, 3] = s, c * ca, -c * sa, a * s
    X[..., 2, 1], X[..., 2, 2], X[..., 2, 3] = sa, ca, d
    X[..., 3, 3] = 1.0
    return X


@dataclass(frozen=True)
class DhParameters:
    """DH parameters of the six joints, standard (distal) convention.

    Attributes:
        d: Link offsets (6,) [m].
        a: Link lengths (6,) [m].
        alpha: Link twists (6,) [rad].
        theta: Joint angle offsets (6,) [rad].
    """

    d: Array
    a: Array
    alpha: Array
    theta: Array

    @classmethod
    def of(cls, model: ArmModel, calibration: DhCalibration | None = None) -> DhParameters:
        """Parameters of an arm model.

        Args:
            model: The arm.
            calibration: Its factory calibration, whose deltas are added; None: nominal kinematics.

        Returns:
            The parameters.
        """
        data = ARM_DATA[model]
        nominal = cls(np.array(data.d), np.array(data.a), np.array(data.alpha), np.zeros(6))
        if calibration is None:
            return nominal
        c = calibration
        return cls(nominal.d + c.delta_d, nominal.a + c.delta_a, nominal.alpha + c.delta_alpha, np.array(c.delta_theta))

    def joint(self, i: int, q: float = 0.0) -> Array:
        """Pose of a DH frame in the one before, Rz(theta) Tz(d) Tx(a) Rx(alpha).

        Args:
            i: Index of the joint, 0 to 5.
            q: Angle of the joint [rad].

        Returns:
            Pose of DH frame i + 1 in frame i, (4, 4).
        """
        return dh_transform(q + self.theta[i], self.d[i], self.a[i], self.alpha[i])

    def fk(self, q: Array) -> Array:
        """Pose (4x4) [m] of the flange in the base frame of the controller at q (6,) [rad]."""
        X = np.eye(4)
        for i in range(6):
            X = X @ self.joint(i, float(q[i]))
        return X

    def zero_frames(self) -> list[Array]:
        """Frames of the arm at q = 0 in the base frame of the controller.

        Returns:
            7 poses, (4, 4) each: the six joint frames, joint axis along z, and the flange.
        """
        frames = [np.eye(4)]
        for i in range(6):
            frames.append(frames[-1] @ self.joint(i))
        return frames


def joint_origins(origins: list[Array], model: ArmModel, calibration: DhCalibration | None) -> list[Array]:
    """Joint origins from `base_link` to `tool0` for a model and a calibration.

    Each link frame, with the shapes and inertia of the link, stays fixed to the body that its joint moves. A
    calibration may shift the frames of parallel joints by metres along their axes and rotate them about these; each
    link frame is placed as close to its nominal pose as this freedom allows.

    Args:
        origins: Joint origins (7 of 4x4) of the URDF of a UR10, the flange last.
        model: The arm.
        calibration: Factory calibration of the arm; None: nominal kinematics.

    Returns:
        Joint origins (7 of 4x4) [m], the flange last.
    """
    ur10, nominal, own = DhParameters.of(ArmModel.UR10), DhParameters.of(model), DhParameters.of(model, calibration)
    X_dh_link = HALF_TURN
    placed = [HALF_TURN]
    for i, (was, wanted, will) in enumerate(zip(*(p.zero_frames() for p in (ur10, nominal, own)), strict=True)):
        X_dh_link = X_dh_link @ origins[i]
        X_turning_link = inverse(was) @ X_dh_link
        if i == 0:  # the shoulder geometry moves with the shoulder joint height d_1
            X_turning_link[2, 3] += nominal.d[0] - ur10.d[0]
        placed.append(will @ (_about_z(inverse(will) @ wanted) if i < 6 else np.eye(4)) @ X_turning_link)
    return [inverse(a) @ b for a, b in pairwise(placed)]


def _about_z(X: Array) -> Array:
    """The screw about z (rotation and translation) closest to X (4x4), which is nearly one."""
    turn = np.arctan2(X[1, 0] - X[0, 1], X[0, 0] + X[1, 1])
    screw = np.eye(4)
    screw[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    screw[2, 3] = X[2, 3]
    return screw
