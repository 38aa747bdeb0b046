"""Rigid-body dynamics of the arm with its hand locked and the tool held: joint torques and the mass behind the face.

Friction of the gearboxes and inertia of the motors' rotors are not modelled: UR publishes neither.
"""

from __future__ import annotations

from typing import Self

import numpy as np
import pinocchio as pin

from toolee_robot.control.robot_model import RobotModel
from toolee_robot.frames import Array, inverse
from toolee_robot.types import Payload


class ArmDynamics:
    """Dynamics of the six arm joints.

    Args:
        robot: Kinematic model of arm and hand.
        q_hand: Joint positions at which the hand is locked, (n,) [rad].
        X_hand_ee: Pose of the end effector in the hand, (4, 4).
        tool: Mass of the tool [kg], a point at its centre of mass, which is given in the end effector's frame [m].
    """

    def __init__(self, robot: RobotModel, q_hand: Array, X_hand_ee: Array, tool: Payload) -> None:
        hand = [robot.model.getJointId(name) for name in robot.description.hand_joints]
        self.model = pin.buildReducedModel(robot.model, hand, robot.configuration(np.zeros(6), q_hand))
        X = robot.arm.X_joint6_flange @ robot.X_flange_hand(q_hand) @ X_hand_ee
        at = pin.SE3(np.eye(3), X[:3, :3] @ tool.center_of_mass + X[:3, 3])
        self.model.appendBodyToJoint(6, pin.Inertia(tool.mass, np.zeros(3), np.zeros((3, 3))), at)
        self._data = self.model.createData()

    @classmethod
    def with_payload(cls, robot: RobotModel, q_hand: Array, payload: Payload) -> Self:
        """Dynamics of the arm with its hand and, as a point mass, what the payload has besides.

        Args:
            robot: Kinematic model of arm and hand.
            q_hand: Joint positions at which the hand is locked, (n,) [rad].
            payload: What the flange carries, hand and tool together, in the flange's frame.

        Returns:
            The dynamics.
        """
        hand = robot.description.hand_payload(q_hand)
        mass = max(payload.mass - hand.mass, 0.0)
        moment = payload.mass * payload.center_of_mass - hand.mass * hand.center_of_mass
        tool = Payload(mass, moment / mass if mass > 1e-6 else np.zeros(3))
        return cls(robot, q_hand, inverse(robot.X_flange_hand(q_hand)), tool)

    def torques(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Compute the joint torques of a motion by inverse dynamics.

        Args:
            q: Joint positions, (N, 6) [rad].
            qd: Joint velocities, (N, 6) [rad/s].
            qdd: Joint accelerations, (N, 6) [rad/s^2].

        Returns:
            Torques, (N, 6) [Nm].
        """
        return np.stack([pin.rnea(self.model, self._data, *row) for row in zip(q, qd, qdd, strict=True)])

    def derivatives(self, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array, Array, Array]:
        """Compute the torques and their derivatives.

        Args:
            q: Joint positions, (N, 6) [rad].
            qd: Joint velocities, (N, 6) [rad/s].
            qdd: Joint accelerations, (N, 6) [rad/s^2].

        Returns:
            Torques, (N, 6) [Nm], and their derivatives with respect to q, qd and qdd, (N, 6, 6) each.
        """
        n, data = len(q), self._data
        tau, by_q, by_qd, by_qdd = np.empty((n, 6)), np.empty((n, 6, 6)), np.empty((n, 6, 6)), np.empty((n, 6, 6))
        for i in range(n):
            pin.computeRNEADerivatives(self.model, data, q[i], qd[i], qdd[i])
            tau[i], by_q[i], by_qd[i], by_qdd[i] = data.tau, data.dtau_dq, data.dtau_dv, _symmetric(data.M)
        return tau, by_q, by_qd, by_qdd

    def at_rest(self, q: Array) -> tuple[Array, Array]:
        """Compute the inertia, (6, 6) [kg m^2], and the gravity's torques, (6,) [Nm], at joint positions q, (6,)."""
        M = _symmetric(pin.crba(self.model, self._data, q))
        return M, pin.computeGeneralizedGravity(self.model, self._data, q).copy()

    def effective_mass(self, q: Array, along: Array) -> float:
        """Compute the mass that strikes along one direction if arm, hand and grip were rigid.

        Args:
            q: Joint positions, (6,) [rad].
            along: Jacobian of the face's speed along the direction, (6,) [m].

        Returns:
            The effective mass, 1 / (J M^-1 J^T) [kg]. Source: Khatib, "Inertial properties in robotic manipulation: an
            object-level framework", 1995.
        """
        return float(1.0 / (along @ np.linalg.solve(self.at_rest(q)[0], along)))


_UPPER, _ABOVE = np.triu(np.ones((6, 6))), np.triu(np.ones((6, 6)), 1)


def _symmetric(M: Array) -> Array:
    """Complete a matrix of which Pinocchio fills the upper triangle."""
    return np.asarray(_UPPER * M + (_ABOVE * M).T)
