"""The motion of one joint that shows a servo's lag: a rest, a sine, a smooth step, a rest, and the step back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.control.planning.timing import SAMPLE_PERIOD
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.station import ArmLimits
from toolee_robot.types import Trajectory

REST = 0.6
"""Duration of every rest [s]."""
PERIODS = 3
"""Whole periods of the sine at its full amplitude; one before and one after grow and fade."""
MARGIN = 0.98
"""Share of the limits that the motion uses."""


@dataclass(frozen=True)
class LagMotion:
    """A motion of one joint that ends where it began.

    Attributes:
        trajectory: The motion of the six joints.
        joint: Index of the joint, 0 to 5.
        speed: Largest speed of the joint [rad/s].
        sine: Times at which the sine begins and ends on the trajectory [s].
        step: Times at which the step begins and ends [s].
        size: Size of the step [rad].
    """

    trajectory: Trajectory
    joint: int
    speed: float
    sine: tuple[float, float]
    step: tuple[float, float]
    size: float

    @property
    def reach(self) -> float:
        """Largest distance of the joint from its start [rad]."""
        q = self.trajectory.q[:, self.joint]
        return float(np.max(np.abs(q - q[0])))


def lag_motion(q: Array, joint: int, speed: float, limits: ArmLimits) -> LagMotion:
    """Build the motion.

    Args:
        q: Present joint positions, (6,) [rad].
        joint: Number of the joint, 1 (base) to 6 (wrist 3).
        speed: Largest speed of the joint [rad/s]; its limit holds where that is lower.
        limits: Limits of velocity, acceleration and jerk.

    Returns:
        The motion, from rest to rest.

    Raises:
        UserError: There is no such joint, or the speed is not positive.
    """
    if not 1 <= joint <= 6:
        raise UserError(f"joint {joint}: give 1 (base) to 6 (wrist 3)", code="user.joint")
    if not speed > 0:
        raise UserError(f"a speed of {speed} rad/s: give a positive number", code="user.speed")
    top = MARGIN * min(speed, limits.velocity[joint - 1])
    acceleration, jerk = MARGIN * limits.acceleration, MARGIN * limits.jerk
    rest = np.zeros((3, round(REST / SAMPLE_PERIOD)))
    wave, step, size = _sine(top, acceleration, jerk), *_step(top, acceleration, jerk)
    x = np.hstack([rest, wave, rest, step, _held(rest, size), _back(step, size), rest])
    times = SAMPLE_PERIOD * np.arange(x.shape[1])
    full = np.zeros((3, x.shape[1], 6))
    full[:, :, joint - 1] = x
    full[0] += q
    begin, long = rest.shape[1], wave.shape[1]
    first = begin + long + rest.shape[1]
    edges = SAMPLE_PERIOD * np.array([begin, begin + long, first, first + step.shape[1]])
    a, b, c, d = edges.tolist()
    return LagMotion(Trajectory(times, *full), joint - 1, float(np.max(np.abs(x[1]))), (a, b), (c, d), size)


def _sine(speed: float, acceleration: float, jerk: float) -> Array:
    """Position, velocity, acceleration of a sine that grows and fades, (3, N); all zero at both ends."""
    # At this frequency a sine of that speed has that acceleration, or that jerk where it is the lower one.
    omega = 0.8 * min(acceleration / speed, np.sqrt(jerk / speed))
    period = 2 * np.pi / omega
    t = np.arange(0.0, (PERIODS + 2) * period, SAMPLE_PERIOD)
    up, down = _smooth(t / period, period), _smooth((PERIODS + 2) - t / period, -period)
    grows = t < (0.5 * PERIODS + 1) * period
    w, dw, ddw = (np.where(grows, a, b) for a, b in zip(up, down, strict=True))
    s, c = np.sin(omega * t), omega * np.cos(omega * t)
    x = np.stack([w * s, dw * s + w * c, ddw * s + 2 * dw * c - w * omega**2 * s])
    jerks = np.abs(np.diff(x[2], append=0.0)) / SAMPLE_PERIOD
    scale = min(speed / np.max(np.abs(x[1])), acceleration / np.max(np.abs(x[2])), jerk / np.max(jerks))
    return np.asarray(scale * x)


def _smooth(u: Array, period: float) -> tuple[Array, Array, Array]:
    """A smooth step in u from 0 to 1, and its first two derivatives by time, where du/dt is 1/period."""
    v = np.clip(u, 0.0, 1.0)
    return (
        v**3 * (10 - 15 * v + 6 * v**2),
        30 * v**2 * (1 - v) ** 2 / period,
        60 * v * (1 - v) * (1 - 2 * v) / period**2,
    )


def _step(speed: float, acceleration: float, jerk: float) -> tuple[Array, float]:
    """Position, velocity, acceleration of a smooth step, (3, N), and its size [rad]."""
    # Of the polynomial of degree 5: largest velocity 15/8, acceleration 5.78, jerk 60, for a size and a duration of 1.
    duration = max(5.78 / 1.875 * speed / acceleration, float(np.sqrt(60 / 1.875 * speed / jerk)))
    size = speed * duration / 1.875
    t = np.arange(0.0, duration, SAMPLE_PERIOD)
    return size * np.stack(_smooth(t / duration, duration)), size


def _held(rest: Array, size: float) -> Array:
    held = rest.copy()
    held[0] = size
    return held


def _back(step: Array, size: float) -> Array:
    back = -step
    back[0] += size
    return np.asarray(back)
