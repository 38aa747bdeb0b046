"""Comparison of arm kinematics by the flange or TCP poses that they predict."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform
from toolee_robot.robots.dh import DhParameters
from toolee_robot.types import ArmModel, DhCalibration

ANGLE_ARM = 0.1
"""[m] Lever arm by which an orientation error is converted to a distance: the hand's length."""


def pose_matrix(pose: Array) -> Array:
    """4x4 of a UR pose (6,): position [m] and rotation vector [rad]."""
    return transform(Rotation.from_rotvec(pose[3:]).as_matrix(), pose[:3])


def angle_between(a: Array, b: Array) -> float:
    """Angle of the rotation between two orientations.

    Args:
        a: An orientation as rotation vector, (3,) [rad].
        b: The other orientation, (3,) [rad].

    Returns:
        The angle in [0, pi] [rad].
    """
    return float((Rotation.from_rotvec(a).inv() * Rotation.from_rotvec(b)).magnitude())


def pose_error(X: Array, Y: Array) -> float:
    """Distance between two poses, with the rotation weighted by ANGLE_ARM.

    Args:
        X: A pose, (4, 4).
        Y: The other pose, in the same frame, (4, 4).

    Returns:
        The distance [m].
    """
    turned = Rotation.from_matrix(X[:3, :3].T @ Y[:3, :3]).magnitude()
    return float(np.hypot(np.linalg.norm(X[:3, 3] - Y[:3, 3]), ANGLE_ARM * turned))


def tcp_error(dh: DhParameters, q: Array, tcp_offset: Array, tcp_pose: Array) -> float:
    """Deviation of a predicted TCP pose from the one that the controller reports.

    Args:
        dh: Kinematic parameters of the arm.
        q: Joint positions, (6,) [rad].
        tcp_offset: TCP in the flange frame, (6,): position [m], rotation vector [rad].
        tcp_pose: TCP in the controller's base, (6,), likewise.

    Returns:
        The deviation [m], see `pose_error`.
    """
    return pose_error(dh.fk(q) @ pose_matrix(tcp_offset), pose_matrix(tcp_pose))


def worst_error(a: DhParameters, b: DhParameters) -> float:
    """Largest deviation between two arms' flange poses over 30 random configurations.

    Args:
        a: Parameters of one arm.
        b: Parameters of the other arm.

    Returns:
        The deviation [m], as in `pose_error`.
    """
    qs = np.random.default_rng(0).uniform(-np.pi, np.pi, (30, 6))
    return max(pose_error(a.fk(q), b.fk(q)) for q in qs)


def calibration_of(dh: DhParameters, model: ArmModel) -> DhCalibration:
    """The calibration of an arm: the value of `arm.calibration` in the station file.

    Args:
        dh: Calibrated kinematic parameters of the arm.
        model: Model of the arm.

    Returns:
        Differences from the model's nominal parameters.
    """
    nominal = DhParameters.of(model)

    def delta(own: Array, of_model: Array) -> tuple[float, float, float, float, float, float]:
        a, b, c, d, e, f = (own - of_model).tolist()
        return a, b, c, d, e, f

    return DhCalibration(
        delta_theta=delta(dh.theta, nominal.theta),
        delta_a=delta(dh.a, nominal.a),
        delta_d=delta(dh.d, nominal.d),
        delta_alpha=delta(dh.alpha, nominal.alpha),
    )
