"""The face at the contact of a swing (its place, Jacobian, speed and deceleration), and a swing's own limits."""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np

from toolee_robot.control.dynamics.arm_dynamics import TORQUE_SHARE, ArmDynamics
from toolee_robot.control.kinematics import ArmKinematics
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.types import Payload


@dataclass(frozen=True)
class SwingLimits:
    """Limits of a swing in addition to `StationConfig.arm` and `supervisor.unattended_speed`.

    Attributes:
        tool: Mass of the tool [kg] and its centre of mass in the end effector's frame [m].
        deepest: Largest distance of the commanded face beyond the contact along the nail's axis [m]; infinite for no
            bound. An arm lags behind its command and would follow it into the wood.
        torque_share: Share of the joints' rated torques that the inverse dynamics may take.
        height_error: Error of the nail's height within which the face is still square to 1 deg [m].

    Raises:
        UserError: A value is out of its range; code `user.swing_limits`.
    """

    tool: Payload
    deepest: float = 0.010
    torque_share: float = TORQUE_SHARE
    height_error: float = 0.003

    def __post_init__(self) -> None:
        if not (self.deepest >= 0.001 and 0 < self.torque_share <= 1 and 0 < self.height_error <= 0.05):
            raise UserError(
                f"swing limits {self.deepest}, {self.torque_share}, {self.height_error}: give at least 1 mm beyond the "
                "contact, a share of the torques up to 1, and a height error of up to 50 mm",
                code="user.swing_limits",
            )


_TINY = 1e-6
"""Weight that makes a linear program strictly convex."""


@dataclass(frozen=True)
class Face:
    """The tool's face in the coordinates of the nail.

    Attributes:
        arm: Kinematics of the arm.
        X_flange_ee: Pose of the end effector in the flange, (4, 4).
        axes: Two directions across the nail's axis and the axis itself, which points into the wood; rows, (3, 3).
        nail: Centre of the nail's head in `base`, (3,) [m].
    """

    arm: ArmKinematics
    X_flange_ee: Array
    axes: Array
    nail: Array

    @classmethod
    def build(cls, arm: ArmKinematics, X_flange_ee: Array, X_base_nail: Array) -> Face:
        """Build from poses.

        Args:
            arm: Kinematics of the arm.
            X_flange_ee: Pose of the end effector in the flange, (4, 4).
            X_base_nail: Pose of the nail, (4, 4), z into the wood.

        Returns:
            The face.
        """
        return cls(arm, X_flange_ee, X_base_nail[:3, :3].T, X_base_nail[:3, 3])

    def place(self, q: Array) -> tuple[Array, Array]:
        """Compute where the face's centre is.

        Args:
            q: Joint positions, (N, 6) [rad].

        Returns:
            Position relative to the nail, (N, 3) [m], and the Jacobian, (N, 6, 6), whose rows are the face's linear
            [m/s] and angular velocity [rad/s]; all along `axes`.
        """
        X, J = self.arm.fk_jacobian(q)
        r = X[:, :3, :3] @ self.X_flange_ee[:3, 3]
        turn = J[:, 3:]
        linear = J[:, :3] + np.swapaxes(np.cross(np.swapaxes(turn, 1, 2), r[:, None]), 1, 2)
        return (X[:, :3, 3] + r - self.nail) @ self.axes.T, np.concatenate([self.axes @ linear, self.axes @ turn], 1)


def fastest(J: Array, velocity: Array) -> float:
    """Compute the speed along the axis that the joints' velocity limits allow with no speed across it.

    Args:
        J: Jacobian of the face along the nail's axes, (6, 6).
        velocity: Velocity limits, (6,) [rad/s].

    Returns:
        The speed [m/s].
    """
    bounds = np.concatenate([velocity, np.zeros(2)])
    sense = np.array([0] * 6 + [5] * 2, dtype=np.int32)
    qd, _, flag, _ = daqp.solve(_TINY * np.eye(6), -J[2], J[:2].copy(), bounds, -bounds, sense)
    return float(J[2] @ qd) if flag > 0 else 0.0


def decelerations(face: Face, dynamics: ArmDynamics, q: Array, acceleration: float, torque: Array) -> Array:
    """Compute the largest deceleration of the face along the nail's axis from the contact on.

    A linear program for each configuration: the joints' accelerations within their limit, the torques of the inverse
    dynamics within theirs, at low speed.

    Args:
        face: The face.
        dynamics: Dynamics of arm, hand and tool.
        q: Configurations at the contact, (N, 6) [rad].
        acceleration: Acceleration limit of every joint [rad/s^2].
        torque: Permitted torques, (6,) [Nm].

    Returns:
        The decelerations, (N,) [m/s^2]; 0 where the arm cannot even hold itself.
    """
    along = face.place(q)[1][:, 2]
    best = np.zeros(len(q))
    top = np.full(6, acceleration)
    H = _TINY * np.eye(6)
    for i, row in enumerate(q):
        M, gravity = dynamics.at_rest(row)
        upper = np.concatenate([top, torque - gravity])
        lower = np.concatenate([-top, -torque - gravity])
        qdd, _, flag, _ = daqp.solve(H, along[i].copy(), M, upper, lower)
        if flag > 0:
            best[i] = -along[i] @ qdd
    return best
