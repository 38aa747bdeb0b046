"""What every arm checks before it moves: the same for the simulated, the stood-in and the real one."""

from __future__ import annotations

import numpy as np

from toolee_robot.errors import LimitError
from toolee_robot.frames import Array
from toolee_robot.types import Payload, Trajectory

START_TOLERANCE = 1e-6
"""[rad] How far a trajectory may begin from the commanded position: what inverse kinematics leaves, no more. An arm
that follows exactly jumps there in one cycle, with a jerk of 2 rate^3 times the jump: 4 rad/s^3 at 125 Hz, 250 at
500 Hz, half of what the planner may use."""


def check_trajectory(trajectory: Trajectory, q_commanded: Array, lower: Array, upper: Array, velocity: Array) -> None:
    """Raise LimitError, before anything moves, unless the arm may drive this trajectory.

    q_commanded: (6,) the present commanded position [rad]. lower, upper: (6,) joint range [rad]. velocity: (6,)
    [rad/s]. A trajectory is rejected, never clipped: a clipped strike is another strike.
    """
    if trajectory.q.shape[1] != 6:
        raise LimitError(f"the arm has 6 joints, the trajectory {trajectory.q.shape[1]}")
    if not all(np.all(np.isfinite(a)) for a in (trajectory.times, trajectory.q, trajectory.qd, trajectory.qdd)):
        raise LimitError("the trajectory has values that are not finite; nothing was moved")
    check_start(trajectory, q_commanded)
    if np.any(trajectory.q < lower) or np.any(trajectory.q > upper):
        raise LimitError("the trajectory leaves the joints' position range; nothing was moved")
    if np.any(np.abs(trajectory.qd) > 1.001 * velocity):
        worst = float((np.abs(trajectory.qd) / velocity).max())
        raise LimitError(f"the trajectory is {worst:.2f} times too fast for a joint; nothing was moved")


def check_start(trajectory: Trajectory, q_commanded: Array) -> None:
    """Raise LimitError unless the trajectory starts at the present commanded position (6,) [rad]."""
    jump = float(np.abs(trajectory.q[0] - q_commanded).max())
    if not jump <= START_TOLERANCE:  # NaN is a jump, too
        raise LimitError(
            f"the trajectory starts {jump:.2g} rad from the commanded position (allowed {START_TOLERANCE:g}); "
            "plan from the q_commanded of the arm's present state"
        )


def check_payload(payload: Payload, capacity: float) -> None:
    """Raise LimitError unless the flange may carry this; capacity [kg] of the model."""
    if not 0.0 <= payload.mass <= capacity:
        raise LimitError(f"payload {payload.mass} kg: this arm carries 0 to {capacity:g} kg")
    if not np.all(np.isfinite(payload.center_of_mass)):
        raise LimitError("the payload's centre of mass is not finite")
