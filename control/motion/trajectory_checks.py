"""Checks of every arm driver before a motion, shared by the simulated arm and the driver of the real one."""

from __future__ import annotations

import numpy as np

from toolee_robot.errors import LimitError
from toolee_robot.frames import Array
from toolee_robot.types import Payload, Trajectory

START_TOLERANCE = 1e-6
"""Largest distance of a trajectory's start from the commanded position [rad]: the residual of inverse kinematics. An
arm that follows exactly covers it in one cycle, with a jerk of 2 rate^3 times the distance: 4 rad/s^3 at 125 Hz,
250 rad/s^3 at 500 Hz, half of the planner's limit."""


def check_trajectory(trajectory: Trajectory, q_commanded: Array, lower: Array, upper: Array, velocity: Array) -> None:
    """Check a trajectory before anything moves; it is rejected rather than clipped.

    Args:
        trajectory: The trajectory.
        q_commanded: Present commanded position, (6,) [rad].
        lower: Lower position limits, (6,) [rad].
        upper: Upper position limits, (6,) [rad].
        velocity: Velocity limits, (6,) [rad/s].

    Raises:
        LimitError: Codes `limit.joint_count`, `limit.not_finite`, `limit.start`, `limit.position`, `limit.velocity`.
    """
    if trajectory.q.shape[1] != 6:
        raise LimitError(f"the arm has 6 joints, the trajectory {trajectory.q.shape[1]}", code="limit.joint_count")
    if not all(np.all(np.isfinite(a)) for a in (trajectory.times, trajectory.q, trajectory.qd, trajectory.qdd)):
        raise LimitError("the trajectory has values that are not finite; nothing was moved", code="limit.not_finite")
    check_start(trajectory, q_commanded)
    if np.any(trajectory.q < lower) or np.any(trajectory.q > upper):
        raise LimitError("the trajectory leaves the joints' position range; nothing was moved", code="limit.position")
    if np.any(np.abs(trajectory.qd) > 1.001 * velocity):
        worst = float((np.abs(trajectory.qd) / velocity).max())
        raise LimitError(
            f"the trajectory is {worst:.2f} times too fast for a joint; nothing was moved", code="limit.velocity"
        )


def check_start(trajectory: Trajectory, q_commanded: Array) -> None:
    """Check that a trajectory starts at the present commanded position.

    Args:
        trajectory: The trajectory.
        q_commanded: The commanded joint positions, (6,) [rad].

    Raises:
        LimitError: It does not; code `limit.start`.
    """
    jump = float(np.abs(trajectory.q[0] - q_commanded).max())
    if not jump <= START_TOLERANCE:  # NaN is a jump, too
        raise LimitError(
            f"the trajectory starts {jump:.2g} rad from the commanded position (allowed {START_TOLERANCE:g}); "
            "plan from the q_commanded of the arm's present state",
            code="limit.start",
        )


def check_payload(payload: Payload, capacity: float) -> None:
    """Check a payload.

    Args:
        payload: Mass properties of what the flange carries.
        capacity: Largest payload of the arm [kg].

    Raises:
        LimitError: Codes `limit.payload_mass` and `limit.payload_not_finite`.
    """
    if not 0.0 <= payload.mass <= capacity:
        raise LimitError(f"payload {payload.mass} kg: this arm carries 0 to {capacity:g} kg", code="limit.payload_mass")
    if not np.all(np.isfinite(payload.center_of_mass)):
        raise LimitError("the payload's centre of mass is not finite", code="limit.payload_not_finite")
