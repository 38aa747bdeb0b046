"""A guarded approach: straight on until the arm feels something, and back to where it began."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from toolee_robot.control import Supervisor
from toolee_robot.errors import DeviceError, UserError
from toolee_robot.frames import Array
from toolee_robot.hal import Arm, ContactGuard
from toolee_robot.tasks.bring_up.caps import SlowStation
from toolee_robot.tasks.bring_up.jog import MotionFrame, plan_line
from toolee_robot.types import Trajectory

SPEED = 0.01
"""Speed of the approach unless another is given [m/s]."""
AVERAGING_WINDOW = 0.024
"""Time over which the force is averaged, as in the touches of a job [s]."""
MOVED = 2e-4
"""Way that is worth going back [m]."""
QUIET_TIME, QUIET_STEP = 0.2, 0.02
"""Time over which the force at rest is read before the approach, and the time between two readings [s]."""


@dataclass(frozen=True)
class Touch:
    """Where a guarded approach met something.

    Attributes:
        travelled: Way of the flange to the contact [m].
        X_base_flange: Measured pose of the flange at the contact, (4, 4).
        force: Largest force of the approach [N].
    """

    travelled: float
    X_base_flange: Array
    force: float


def force_at_rest(arm: Arm) -> float:
    """Magnitude of the mean force at rest over QUIET_TIME [N]."""
    readings = []
    for _ in range(round(QUIET_TIME / QUIET_STEP)):
        readings.append(arm.state().wrench[:3])
        time.sleep(QUIET_STEP)
    return float(np.linalg.norm(np.mean(readings, axis=0)))


def approach(arm: Supervisor, slow: SlowStation, trajectory: Trajectory, force: float) -> Touch | None:
    """Zero the force, move until the arm feels one, then back to where the approach began.

    Args:
        arm: The arm, under the supervisor.
        slow: The station under its caps.
        trajectory: The approach, from `plan_line`.
        force: Force at the flange that ends it [N].

    Returns:
        The contact; None where the way ended without one.

    Raises:
        UserError: The force is not positive.
        DeviceError: The arm feels half of it already at rest.
        TooleeError: What `Supervisor.execute` raises.
    """
    if not force > 0:
        raise UserError(f"a force of {force} N: give a positive number", code="user.force")
    arm.zero_wrench()
    felt = force_at_rest(arm)
    if not felt < 0.5 * force:
        raise DeviceError(
            f"just zeroed, the arm feels {felt:.1f} N at rest, half of {force:g} N or more: take away what touches it, "
            "or raise the force",
            code="device.force_at_rest",
        )
    report = arm.execute(trajectory, ContactGuard(force, averaging_window=AVERAGING_WINDOW), at_work=True)
    places = slow.robot.arm.fk(np.stack([trajectory.q[0], report.q_commanded[-1]]))[:, :3, 3]
    if np.linalg.norm(way := places[0] - places[1]) > MOVED:
        arm.execute(plan_line(slow, report.q_commanded[-1], way, MotionFrame.BASE_LINK), at_work=True)
    if report.contact is None:
        return None
    X_base_flange = slow.robot.arm.fk(report.contact.q)
    travelled = float(np.linalg.norm(X_base_flange[:3, 3] - places[0]))
    return Touch(travelled, X_base_flange, float(np.max(np.linalg.norm(report.wrenches[:, :3], axis=1))))
