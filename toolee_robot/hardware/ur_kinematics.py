"""Which model do the controller's own figures fit? It tells joints and TCP pose, not its kinematics."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform
from toolee_robot.robots.dh import DhParameters
from toolee_robot.types import ArmModel, DhCalibration


def pose_matrix(pose: Array) -> Array:
    """4x4 of a UR pose (6,): position [m] and rotation vector [rad]."""
    return transform(Rotation.from_rotvec(pose[3:]).as_matrix(), pose[:3])


def angle_between(a: Array, b: Array) -> float:
    """Angle [rad] between two rotation vectors (3,) [rad]."""
    return float((Rotation.from_rotvec(a).inv() * Rotation.from_rotvec(b)).magnitude())


def model_error(
    model: ArmModel, calibration: DhCalibration | None, q: Array, tcp_offset: Array, tcp_pose: Array
) -> float:
    """Distance [m] of the TCP by this model at q (6,) from where the controller says that it is.

    tcp_offset: (6,) in the flange. tcp_pose: (6,) in the controller's base. The orientation counts as if 0.1 m away.
    """
    X = DhParameters.of(model, calibration).fk(q) @ pose_matrix(tcp_offset)
    Y = pose_matrix(tcp_pose)
    turned = Rotation.from_matrix(X[:3, :3].T @ Y[:3, :3]).magnitude()
    return float(np.hypot(np.linalg.norm(X[:3, 3] - Y[:3, 3]), 0.1 * turned))


def best_model(q: Array, tcp_offset: Array, tcp_pose: Array) -> tuple[ArmModel, float]:
    """The nominal model that fits best, and its error [m]."""
    errors = {model: model_error(model, None, q, tcp_offset, tcp_pose) for model in ArmModel}
    best = min(errors, key=lambda m: errors[m])
    return best, errors[best]
