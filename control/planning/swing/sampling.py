"""From the limits to a spline's knots, and from its coefficients to a sampled trajectory within the limits."""

from __future__ import annotations

import numpy as np

from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.dynamics.arm_dynamics import ArmDynamics
from toolee_robot.control.dynamics.torque_room import torque_use
from toolee_robot.control.modes import carried_speed
from toolee_robot.control.planning.swing.spline import Spline
from toolee_robot.control.planning.timing import SAMPLE_PERIOD
from toolee_robot.frames import Array
from toolee_robot.station import ArmLimits
from toolee_robot.types import Trajectory

BEFORE, AFTER = 10, 8
"""Intervals of the spline before and after the contact."""


def spline_for(limits: ArmLimits) -> Spline:
    """Build a spline that is long enough for a swing.

    The intervals before the contact take a joint from rest to some 2 rad/s and from full acceleration to full
    deceleration, with 40 % to spare.

    Args:
        limits: Limits of acceleration and jerk.

    Returns:
        The spline; the time between two knots is a multiple of the sample period.
    """
    needed = 1.4 * (2.0 / limits.acceleration + 3.0 * limits.acceleration / limits.jerk)
    return Spline.build(SAMPLE_PERIOD * max(4, round(needed / BEFORE / SAMPLE_PERIOD)), BEFORE, AFTER)


def sampled_within(
    spline: Spline,
    dynamics: ArmDynamics,
    world: CollisionWorld,
    q_contact: Array,
    x: Array,
    torque: Array,
    speed: float,
) -> tuple[Trajectory, int]:
    """Sample a solution, slowed down by what it exceeds the limits that were linearised.

    Slowing keeps the path, and so its deepest place.

    Args:
        spline: The spline.
        dynamics: Dynamics of arm, hand and tool.
        world: Bodies of hand and tool.
        q_contact: Joint positions at the contact, (6,) [rad].
        x: Coefficients, (6, m), relative to `q_contact`.
        torque: Permitted torques, (6,) [Nm].
        speed: Largest speed of any point of hand and tool [m/s].

    Returns:
        The trajectory, and the index of the sample at the contact.

    Raises:
        LimitError: Gravity alone exceeds a torque; code `limit.torque`.
    """
    trajectory, contact = _sampled(spline, q_contact, x, 1.0)
    fastest = float(np.max(carried_speed(trajectory, world)))
    slower = max(float(np.sqrt(np.max(torque_use(dynamics, trajectory, torque)))), fastest / (0.998 * speed))
    return (trajectory, contact) if slower <= 1.0 else _sampled(spline, q_contact, x, slower * (1 + 1e-4))


def _sampled(spline: Spline, q_contact: Array, x: Array, slower: float) -> tuple[Trajectory, int]:
    per_interval = int(np.ceil(spline.step * slower / SAMPLE_PERIOD - 1e-9))
    times = np.linspace(0.0, spline.knots[-1], spline.intervals * per_interval + 1)
    q, qd, qdd = (spline.at(times, order) @ x.T for order in range(3))
    return Trajectory(slower * times, q_contact + q, qd / slower, qdd / slower**2), spline.contact * per_interval
