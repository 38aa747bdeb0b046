"""Stiffness and damping of the assisted grip that explicit integration keeps stable.

The engine integrates applied forces explicitly, so a spring and damper that are too stiff for the tool add energy: a
hammer's inertia about its handle is 1.3e-4 to 9e-4 kg m^2, and 0.5 Nm s/rad with steps of 1 ms diverge below 2.5e-4.
Stiffness and damping are therefore limited to what explicit steps keep stable for the tool (`GripGains.stable`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.physics.bodies import pb, quiet, rotation_matrix

STIFFNESS = 3e4  # [N/m], at most
DAMPING = 60.0  # [N s/m], at most
ANGULAR_STIFFNESS = 500.0  # [Nm/rad], at most
ANGULAR_DAMPING = 0.5  # [Nm s/rad], at most
STABILITY_NUMBER = 1.0  # upper bound for each motion; explicit steps are stable below 4 / 3 (GripGains.stable)


@dataclass(frozen=True)
class GripGains:
    """Stiffness and damping of the connection, isotropic in each of its three motions.

    Attributes:
        stiffness: Stiffness against a shift of the grip point [N/m].
        damping: Damping of a shift [N s/m].
        about_stiffness: Stiffness against a rotation about the handle [Nm/rad].
        about_damping: Damping of a rotation about the handle [Nm s/rad].
        tilt_stiffness: Stiffness against a tilt of the handle [Nm/rad].
        tilt_damping: Damping of a tilt [Nm s/rad].
    """

    stiffness: float
    damping: float
    about_stiffness: float
    about_damping: float
    tilt_stiffness: float
    tilt_damping: float

    @classmethod
    def stable(cls, mobility: Array, handle: Array, time_step: float) -> GripGains:
        """The stiffest connection, up to the constants above, that explicit steps of this length keep passive.

        Semi-implicit Euler steps h of M a = -K x - D v are stable where M - h D / 2 - h^2 K / 4 is positive definite,
        that is, where every eigenvalue of (h^2 K + 2 h D) M^-1 is below 4. K and D are block diagonal over shift, turn
        and tilt, and M^-1 <= 3 blockdiag(M^-1), as for any positive semidefinite matrix of three blocks. So
        (h^2 k + 2 h d) w < 4 / 3 in each block is enough, with w the largest eigenvalue of its inverse inertia.

        Args:
            mobility: (6, 6) inverse inertia [1/kg, 1/(kg m), 1/(kg m^2)] of tool against palm at the grip point: the
                relative acceleration (linear, angular) that a unit wrench (force, torque) between the two causes.
            handle: (3,) unit vector along the handle, in the same axes.
            time_step: The longest time step [s].

        Returns:
            The gains.
        """
        linear, angular = mobility[:3, :3], mobility[3:, 3:]
        across = np.eye(3) - np.outer(handle, handle)
        w_shift = float(np.linalg.eigvalsh(linear)[-1])
        w_about = float(handle @ angular @ handle)
        w_tilt = float(np.linalg.eigvalsh(across @ angular @ across)[-1])

        def limited(stiffness: float, damping: float, w: float) -> tuple[float, float]:
            scale = min(1.0, STABILITY_NUMBER / ((time_step**2 * stiffness + 2.0 * time_step * damping) * w))
            return scale * stiffness, scale * damping

        return cls(
            *limited(STIFFNESS, DAMPING, w_shift),
            *limited(ANGULAR_STIFFNESS, ANGULAR_DAMPING, w_about),
            *limited(ANGULAR_STIFFNESS, ANGULAR_DAMPING, w_tilt),
        )


def tool_mobility(client: int, tool: int, R: Array, arm: Array) -> Array:
    """Inverse inertia (6, 6) of a free body at a point, in the axes of a frame.

    Args:
        client: pybullet's physics client.
        tool: pybullet's id of the body.
        R: The body's inertial axes in the frame, (3, 3).
        arm: Vector from the body's centre of mass to the point, (3,) [m], in the frame's axes.

    Returns:
        The inverse inertia.
    """
    mass, _, moments = pb.getDynamicsInfo(tool, -1, physicsClientId=client)[:3]
    angular = R @ np.diag(1.0 / np.array(moments)) @ R.T
    x, y, z = arm
    cross_arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    coupling = -cross_arm @ angular
    return np.block([[np.eye(3) / mass + coupling @ cross_arm, coupling], [coupling.T, angular]])


def palm_mobility(client: int, robot: int, palm: int, p_hand_grip: Array) -> Array:
    """Inverse inertia (6, 6) of the palm at the grip point, palm's axes, with all joints free.

    This is an upper bound, which holds when the motors are saturated.

    Args:
        client: pybullet's physics client.
        robot: pybullet's id of the robot.
        palm: Index of the palm's link.
        p_hand_grip: Grip point in the palm's frame, (3,) [m].

    Returns:
        The inverse inertia.
    """
    links = range(pb.getNumJoints(robot, physicsClientId=client))
    joints = [i for i in links if pb.getJointInfo(robot, i, physicsClientId=client)[2] != pb.JOINT_FIXED]
    if not joints:
        return np.zeros((6, 6))
    q = [state[0] for state in pb.getJointStates(robot, joints, physicsClientId=client)]
    zeros = [0.0] * len(q)
    state = pb.getLinkState(robot, palm, physicsClientId=client)
    R_palm = rotation_matrix(state[5])
    # pybullet takes the point in the link's inertial frame.
    point = rotation_matrix(state[3]).T @ (p_hand_grip - np.array(state[2]))
    with quiet(1):  # it warns about axes of the URDF that are unit vectors in single precision only
        linear, angular = pb.calculateJacobian(robot, palm, point.tolist(), q, zeros, zeros, physicsClientId=client)
        M = np.array(pb.calculateMassMatrix(robot, q, physicsClientId=client))
    J = np.vstack([R_palm.T @ np.array(linear), R_palm.T @ np.array(angular)])
    return np.asarray(J @ np.linalg.solve(M, J.T))
