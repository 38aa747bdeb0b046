"""Denavit-Hartenberg parameters of the UR arms, and how a URDF's joint origins follow from them.

X_base_flange(q) = prod_i Rz(q_i + theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i), where `base` is the controller's base, which is
our `base_link` turned by half a turn about z, and `flange` is `tool0`. A factory calibration adds a delta to every one
of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.frames import Array, inverse
from toolee_robot.types import ArmModel, DhCalibration

HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""X_baselink_base: the UR controller's base in the URDF's `base_link`."""


@dataclass(frozen=True)
class DhParameters:
    """d, a [m] and theta, alpha [rad] of the six joints, (6,) each, standard (distal) convention."""

    d: Array
    a: Array
    alpha: Array
    theta: Array

    @classmethod
    def of(cls, model: ArmModel, calibration: DhCalibration | None = None) -> DhParameters:
        """Those of a model, nominal or with an arm's own calibration."""
        data = ARM_DATA[model]
        nominal = cls(np.array(data.d), np.array(data.a), np.array(data.alpha), np.zeros(6))
        if calibration is None:
            return nominal
        c = calibration
        return cls(nominal.d + c.delta_d, nominal.a + c.delta_a, nominal.alpha + c.delta_alpha, np.array(c.delta_theta))

    def joint(self, i: int, q: float = 0.0) -> Array:
        """Pose (4x4) of frame i + 1 in frame i at the joint angle q [rad], i from 0."""
        c, s, ca, sa = (
            np.cos(q + self.theta[i]),
            np.sin(q + self.theta[i]),
            np.cos(self.alpha[i]),
            np.sin(self.alpha[i]),
        )
        return np.array(
            [
                [c, -s * ca, s * sa, self.a[i] * c],
                [s, c * ca, -c * sa, self.a[i] * s],
                [0.0, sa, ca, self.d[i]],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )

    def fk(self, q: Array) -> Array:
        """The flange (4x4) in the controller's base at q (6,) [rad]."""
        X = np.eye(4)
        for i in range(6):
            X = X @ self.joint(i, float(q[i]))
        return X

    def zero_frames(self) -> list[Array]:
        """Poses (4x4) in the controller's base, at q = 0, of the frames that turn about their z with joints 1 to 6,
        and of the flange: 7."""
        frames = [np.eye(4)]
        for i in range(6):
            frames.append(frames[-1] @ self.joint(i))
        return frames


def joint_origins(origins: list[Array], model: ArmModel, calibration: DhCalibration | None) -> list[Array]:
    """Joint origins (7 of 4x4, the last one the flange's) of `base_link` to `tool0` for a model and a calibration.

    origins: those of a UR10's URDF. Every link's frame stays fixed to what turns with its joint, and the links' shapes
    and inertias with it. A calibration may put the parallel joints' frames metres away along their axes, and turn them
    about these; a link's frame stays as near as it can to where it nominally is.
    """
    ur10, nominal, own = DhParameters.of(ArmModel.UR10), DhParameters.of(model), DhParameters.of(model, calibration)
    X_dh_link = HALF_TURN
    placed = [HALF_TURN]
    for i, (was, wanted, will) in enumerate(zip(*(p.zero_frames() for p in (ur10, nominal, own)), strict=True)):
        X_dh_link = X_dh_link @ origins[i]
        X_turning_link = inverse(was) @ X_dh_link
        if i == 0:  # the shoulder stands on the base, not at its own frame: it rises with what it carries
            X_turning_link[2, 3] += nominal.d[0] - ur10.d[0]
        placed.append(will @ (_about_z(inverse(will) @ wanted) if i < 6 else np.eye(4)) @ X_turning_link)
    return [inverse(a) @ b for a, b in pairwise(placed)]


def _about_z(X: Array) -> Array:
    """What of X (4x4), nearly a screw about z, is a screw about z."""
    turn = np.arctan2(X[1, 0] - X[0, 1], X[0, 0] + X[1, 1])
    screw = np.eye(4)
    screw[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    screw[2, 3] = X[2, 3]
    return screw
