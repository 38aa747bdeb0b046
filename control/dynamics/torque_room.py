"""How much of the torque that gravity leaves a motion takes."""

from __future__ import annotations

import numpy as np

from toolee_robot.control.dynamics.arm_dynamics import ArmDynamics
from toolee_robot.errors import LimitError
from toolee_robot.frames import Array
from toolee_robot.types import Trajectory

TORQUE_SHARE = 0.9
"""Share of the joints' rated torques that the inverse dynamics of a strike may take. The rest is for what is not
modelled: friction, the motors' rotors, errors of the masses."""


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
