"""How much of the torque that gravity leaves a motion takes, and how hard a stop on its path may brake."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control.dynamics.arm_dynamics import ArmDynamics
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import LimitError
from toolee_robot.frames import Array
from toolee_robot.types import ArmModel, Payload, Trajectory

TORQUE_SHARE = 0.9
"""Share of the joints' rated torques that the inverse dynamics of a strike may take. The rest is for what is not
modelled: friction, the motors' rotors, errors of the masses."""
MOST_BRAKING = 1e3
"""Deceleration that stands for no bound [rad/s^2]."""
_STILL = 1e-6  # [rad/s]


def torque_use(dynamics: ArmDynamics, trajectory: Trajectory, torque: Array) -> Array:
    """Compute what a motion takes of the torques that are left beside gravity's.

    Args:
        dynamics: Dynamics of arm, hand and tool.
        trajectory: The motion, N samples.
        torque: Permitted torques, (6,) [Nm].

    Returns:
        The largest share over the joints at each sample, (N,); above 1 the motion takes more than is permitted.

    Raises:
        LimitError: Gravity alone exceeds a torque; code `limit.torque`.
    """
    rest = np.zeros_like(trajectory.q)
    static = dynamics.torques(trajectory.q, rest, rest)
    dynamic = dynamics.torques(trajectory.q, trajectory.qd, trajectory.qdd) - static
    room = torque - np.sign(dynamic) * static
    if np.any(room <= 0):
        raise LimitError("holding the arm takes more torque than is permitted", code="limit.torque")
    return np.asarray(np.max(np.abs(dynamic) / room, axis=1))


def permitted_braking(dynamics: ArmDynamics, trajectory: Trajectory, torque: Array) -> Array:
    """Compute how hard a stop on a motion's path may brake within the joints' torques.

    With e the unit tangent of the path in joint space, v the speed along it and P the part of the planned acceleration
    across it, a stop at the share r of the planned speed takes

        tau = g(q) + r^2 (M P + C(q, q')) + M e v'

    (Bobrow, Dubowsky and Gibson, "Time-optimal control of robotic manipulators along specified paths", 1985). It is
    linear in r^2 and v', so that between r = 0 and r = 1 everything is permitted that lies between what they permit, in
    proportion to r^2.

    Args:
        dynamics: Dynamics of arm, hand and tool.
        trajectory: The motion, N samples.
        torque: Permitted torques, (6,) [Nm].

    Returns:
        The largest deceleration along the path at each sample, at rest and at the planned speed, (N, 2) [rad/s^2], at
        most MOST_BRAKING; 0 or less where gravity and speed alone exceed a torque.
    """
    speed = np.linalg.norm(trajectory.qd, axis=1)
    moving = speed > _STILL
    if not np.any(moving):
        return np.full((len(speed), 2), MOST_BRAKING)
    q, qd, qdd = trajectory.q[moving], trajectory.qd[moving], trajectory.qdd[moving]
    e = qd / speed[moving, None]
    across = qdd - np.sum(e * qdd, axis=1)[:, None] * e
    rest = np.zeros_like(q)
    standing = dynamics.torques(q, rest, rest)
    by_braking = standing - dynamics.torques(q, rest, e)  # per unit of deceleration
    along = np.maximum(np.abs(by_braking), 1e-9)
    permitted = []
    for tau in (standing, dynamics.torques(q, qd, across)):
        room = torque - np.sign(by_braking) * tau
        braking = np.minimum(np.min(room / along, axis=1), MOST_BRAKING)
        # At rest, where the path has no tangent: as where it begins or ends to move.
        permitted.append(np.interp(trajectory.times, trajectory.times[moving], braking))
    return np.stack(permitted, axis=1)


def bound_stop(
    trajectory: Trajectory, robot: RobotModel, model: ArmModel, q_hand: Array, payload: Payload | None
) -> Trajectory:
    """Bound the stops on a motion by TORQUE_SHARE of the joints' torques.

    Args:
        trajectory: The motion.
        robot: Kinematic model of arm and hand.
        model: Model of the arm.
        q_hand: Joint positions of the hand, wrist first, (n,) [rad].
        payload: What the flange carries, hand and tool together; None for the hand alone.

    Returns:
        The motion, with its permitted braking.
    """
    carried = robot.description.hand_payload(q_hand) if payload is None else payload
    dynamics = ArmDynamics.with_payload(robot, q_hand, carried)
    torque = TORQUE_SHARE * np.array(ARM_DATA[model].torque)
    return replace(trajectory, braking=permitted_braking(dynamics, trajectory, torque))
