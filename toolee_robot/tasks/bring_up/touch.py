"""A guarded approach: straight on until the arm feels something, and back to where it began."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.control import Supervisor
from toolee_robot.control.motion.touch_force import (
    CONFIRM_SHARE,
    MAX_PHANTOMS,
    TouchSettings,
    forces_at_rest,
    touch_settings,
)
from toolee_robot.errors import DeviceError, UserError
from toolee_robot.frames import Array
from toolee_robot.hal import Arm, Clock, ContactGuard
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import StrikeConfig
from toolee_robot.tasks.bring_up.slow_motions import SLOWEST, MotionFrame, SlowStation, plan_line
from toolee_robot.types import Trajectory

SPEED = 0.01
"""Speed of the approach unless another is given [m/s]; a noisy force lowers it."""
MOVED = 2e-4
"""Way that is worth going back, or on [m]."""
NOISE_TIME = 1.0
"""Time over which the noise of the force is measured at rest [s]."""
QUIET_TIME = 0.2
"""Time over which a quiet force is read at rest, before the approach and after a contact [s]; a noisy one is read for
NOISE_TIME, and none shorter than the window."""


@dataclass(frozen=True)
class Touch:
    """Where a guarded approach met something.

    Attributes:
        q: Measured joint positions at the contact, (6,) [rad].
        travelled: Way of the flange to the contact [m].
        X_base_flange: Measured pose of the flange at the contact, (4, 4).
        force: Force that presses at rest after it [N].
    """

    q: Array
    travelled: float
    X_base_flange: Array
    force: float


def measured_settings(arm: Arm, strike: StrikeConfig, force: float, clock: Clock | None = None) -> TouchSettings:
    """Measure the noise of the force at rest, and choose how to touch with it, as a job does.

    Args:
        arm: The arm, at rest.
        strike: The station's speed of a touch.
        force: Force at the flange that ends the approach if the noise lets it [N].
        clock: The station's clock; None for the host's.

    Returns:
        Threshold, averaging window and largest speed.

    Raises:
        UserError: The force is not positive.
        DeviceError: The force is too noisy for it.
    """
    if not force > 0:
        raise UserError(f"a force of {force} N: give a positive number")
    forces = forces_at_rest(arm, clock or HostClock(), NOISE_TIME)
    return touch_settings(forces, arm.rate, replace(strike, touch_force=force))


def approach(
    arm: Supervisor,
    slow: SlowStation,
    trajectory: Trajectory,
    settings: TouchSettings,
    clock: Clock | None = None,
) -> Touch | None:
    """Zero the force, move until the arm feels one, then back to where the approach began.

    Where nothing presses at rest after a contact it was none, a peak of the noise, and the approach goes on.

    Args:
        arm: The arm, under the supervisor.
        slow: The station under its caps.
        trajectory: The approach, from `plan_line`.
        settings: Threshold and window, from `measured_settings`.
        clock: The station's clock; None for the host's.

    Returns:
        The contact; None where the way ended without one.

    Raises:
        DeviceError: The arm feels a force already at rest, or contacts that are none again and again.
        TooleeError: What `Supervisor.execute` raises.
    """
    clock = clock or HostClock()
    quiet = max(QUIET_TIME if settings.release is None else NOISE_TIME, settings.window)
    for _ in range(MAX_PHANTOMS):  # zero and reading both have the noise
        arm.zero_wrench()
        felt = float(np.linalg.norm(np.mean(forces_at_rest(arm, clock, quiet), axis=0)))
        if felt < CONFIRM_SHARE * settings.force:
            break
    else:
        raise DeviceError(
            f"after zeroing, the arm feels {felt:.1f} N at rest, half of {settings.force:.1f} N or more. Remove "
            "what touches it, or raise the force"
        )
    fk = slow.robot.arm.fk
    begin, end = fk(trajectory.q[[0, -1]])[:, :3, 3]
    guard = ContactGuard(settings.force, averaging_window=settings.window)
    touch, phantoms, report = None, 0, arm.execute(trajectory, guard, at_work=True)
    while report.contact is not None:
        pressing = float(np.linalg.norm(np.mean(forces_at_rest(arm, clock, quiet), axis=0)))
        if pressing >= CONFIRM_SHARE * settings.force:
            X_base_flange = fk(report.contact.q)
            travelled = float(np.linalg.norm(X_base_flange[:3, 3] - begin))
            touch = Touch(report.contact.q, travelled, X_base_flange, pressing)
            break
        phantoms += 1
        q = report.q_commanded[-1]
        left = end - fk(q)[:3, 3]
        if phantoms == MAX_PHANTOMS or np.linalg.norm(left) < MOVED:
            break
        speed = float(np.linalg.norm(end - begin)) / trajectory.duration
        report = arm.execute(plan_line(slow, q, left, MotionFrame.BASE_LINK, max(speed, SLOWEST)), guard, at_work=True)
    q = report.q_commanded[-1]
    if np.linalg.norm(back := begin - fk(q)[:3, 3]) > MOVED:
        arm.execute(plan_line(slow, q, back, MotionFrame.BASE_LINK), at_work=True)
    if phantoms == MAX_PHANTOMS:
        raise DeviceError(
            f"the force rose above {settings.force:.1f} N {phantoms} times without contact. Keep hand and cables "
            "from swinging or pulling, then check the force with `toolee doctor`",
            code="device.force_noise",
        )
    return touch
