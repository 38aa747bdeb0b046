"""Correction of the in-hand offset: flange poses with which the tool's end effector meets the nail.

    X_base_flange(theta) = X_base_nail . Rz(theta) . X_flange_ee^-1,    X_flange_ee = X_flange_hand . X_hand_ee

The face and the nail's head are round, so the spin theta about the nail's axis is free. It is sampled together with the
branches of the inverse kinematics; `rank` defines the score of the candidates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolee_robot.control.inverse_kinematics import InverseKinematics
from toolee_robot.control.kinematics import smallest_singular_value, solve
from toolee_robot.errors import UnreachableError
from toolee_robot.frames import Array, inverse
from toolee_robot.station import ArmLimits

SPIN_STEP = np.deg2rad(7.5)
"""Step of the sampled spins [rad]."""


@dataclass(frozen=True)
class Candidates:
    """C configurations that place the end effector on the nail.

    Attributes:
        theta: Spins about the nail's axis, (C,) [rad].
        branch: Branches of the inverse kinematics, (C,).
        q: Joint positions, (C, 6) [rad].
        attainable_speed: min_i qdot_max_i / |[J^-1 (n, 0)]_i| for the driving direction n, (C,) [m/s].
        margin: Least distance to a joint's position limit, (C,) [rad].
        manipulability: Smallest singular value of the Jacobian in metres and radians, (C,).
    """

    theta: Array
    branch: NDArray[np.intp]
    q: Array
    attainable_speed: Array
    margin: Array
    manipulability: Array

    def take(self, rows: NDArray[np.intp]) -> Candidates:
        """Select candidates by their indices."""
        return Candidates(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


def flange_targets(X_base_nail: Array, X_flange_ee: Array, theta: Array) -> Array:
    """Compute the flange poses that place the end effector on the nail.

    Args:
        X_base_nail: Pose of the nail, (4, 4).
        X_flange_ee: Pose of the end effector in the flange, (4, 4).
        theta: Spins about the nail's axis, (...) [rad].

    Returns:
        X_base_flange, (..., 4, 4).
    """
    spin = np.zeros((*np.shape(theta), 4, 4))
    spin[..., 0, 0] = spin[..., 1, 1] = np.cos(theta)
    spin[..., 1, 0] = np.sin(theta)
    spin[..., 0, 1] = -spin[..., 1, 0]
    spin[..., 2, 2] = spin[..., 3, 3] = 1.0
    return X_base_nail @ spin @ inverse(X_flange_ee)


def candidates(
    ik: InverseKinematics, X_base_nail: Array, X_flange_ee: Array, limits: ArmLimits, near: Array
) -> Candidates:
    """Find every spin, in steps of SPIN_STEP, and branch that reaches the nail.

    Args:
        ik: Inverse kinematics of the arm.
        X_base_nail: Pose of the nail, (4, 4).
        X_flange_ee: Pose of the end effector in the flange, (4, 4).
        limits: Velocity limits of the joints.
        near: Joint positions to which the whole turns are nearest, (6,) [rad].

    Returns:
        The configurations that reach the nail within the position limits.

    Raises:
        UnreachableError: No spin reaches the nail.
    """
    theta = np.arange(-np.pi, np.pi - 1e-9, SPIN_STEP)
    q = ik.branches(flange_targets(X_base_nail, X_flange_ee, theta))
    found = np.all(np.isfinite(q), axis=-1)
    rows, branch = np.nonzero(found)
    q = ik.unwrap(q[found], near)
    margin = np.min(np.minimum(q - ik.arm.lower, ik.arm.upper - q), axis=-1)
    inside = margin > 0
    if not np.any(inside):
        p = X_base_nail[:3, 3]
        raise UnreachableError(
            f"no posture of the arm brings the tool onto the nail at {np.round(p, 3).tolist()} m in base_link "
            f"({np.linalg.norm(p):.2f} m from the base): move the block, or put it on a higher stand",
            code="unreachable.nail",
        )
    q, rows, branch, margin = q[inside], rows[inside], branch[inside], margin[inside]
    _, J = ik.arm.fk_jacobian(q)
    direction = np.concatenate([X_base_nail[:3, 2], np.zeros(3)])
    rates = np.abs(solve(J, np.broadcast_to(direction, (len(q), 6))))
    attainable = np.min(np.asarray(limits.velocity) / np.maximum(rates, 1e-9), axis=-1)
    sigma = smallest_singular_value(J)
    return Candidates(theta[rows], branch, q, attainable, margin, sigma)


def rank(found: Candidates, wanted_speed: float, near: Array) -> Array:
    """Compute the kinematic score of candidates; `planning.strike` adds the clearance.

    Speed counts up to 1.5 times the wanted speed (the reserve is needed for the joints' accelerations), the margin up
    to 0.6 rad, the manipulability up to 0.1. The distance from `near` breaks ties.

    Args:
        found: The candidates.
        wanted_speed: Wanted speed of the face at the contact [m/s].
        near: Present joint positions, (6,) [rad].

    Returns:
        The scores, (C,); higher is better.
    """
    speed = np.minimum(found.attainable_speed / wanted_speed, 1.5)
    margin = np.minimum(found.margin / 0.6, 1.0)
    dexterity = np.minimum(found.manipulability / 0.1, 1.0)
    travel = np.max(np.abs(found.q - near), axis=-1) / np.pi
    return speed + 0.3 * margin + 0.3 * dexterity - 0.15 * travel
