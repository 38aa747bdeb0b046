"""The force of a guarded touch: threshold, window and speed by the noise at rest, and where the force began to rise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.config import StrikeConfig
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import ZERO_TIME

WINDOW_WAY, LONGEST_WINDOW = 0.00144, 0.3
"""Travel over which the force of a touch is averaged [m]: 48 ms, six readings of a CB3, at 0.03 m/s; and the longest
time for it [s]."""
QUIET = 1.0
"""Standard deviation of the force up to which a touch goes at `strike.touch_speed` [N]; with more, slower."""
SLOWEST = 0.2
"""Least speed of a touch as a share of `strike.touch_speed`."""
SIGMAS = 4.5
"""Threshold of a contact in standard deviations of the window's mean force: one touch in some fifty with a CB3's noise
is a phantom, which is recognised."""
MAX_FACTOR = 1.5
"""The noise may raise the threshold to this multiple of `strike.touch_force`; with more, nothing is touched."""
SLOPE_RANGE = 0.008
"""Height above the end of a touch over which the rise of the force is examined [m]."""


@dataclass(frozen=True)
class TouchSettings:
    """How to touch with the force's present noise.

    Attributes:
        force: Mean force that counts as a contact [N].
        window: Averaging window [s].
        speed: Speed of the touch [m/s].
    """

    force: float
    window: float
    speed: float


def touch_settings(forces: Array, rate: float, strike: StrikeConfig) -> TouchSettings:
    """Choose threshold, window and speed of a touch by the noise of the force.

    The threshold bears the noise of the window's mean, correlated as it is, and of the zero.

    Args:
        forces: Readings of the force at rest, one a cycle, (N, 3) [N].
        rate: Rate of the readings [Hz].
        strike: Speed and force of a touch as configured.

    Returns:
        The settings.

    Raises:
        DeviceError: The force is too noisy for the configured threshold.
    """
    sigma = float(np.sqrt(np.mean(np.var(forces, axis=0, ddof=1))))
    speed = strike.touch_speed * min(1.0, max(QUIET / max(sigma, 1e-9), SLOWEST))
    window = min(WINDOW_WAY / speed, LONGEST_WINDOW)
    # The zero is a mean, too, of a longer time.
    needed = SIGMAS * deviation_of_mean(forces, rate, window) * float(np.sqrt(1.0 + window / ZERO_TIME))
    if needed > MAX_FACTOR * strike.touch_force:
        raise DeviceError(
            f"at rest the force varies so much (standard deviation {sigma:.1f} N) that only {needed:.0f} N would be a "
            f"sure contact, strike.touch_force is {strike.touch_force:g} N: nothing is touched. Check the payload, "
            "wait until nothing swings, or raise it as far as the hand can bear",
            code="device.force_noise",
        )
    return TouchSettings(max(strike.touch_force, needed), window, speed)


def deviation_of_mean(forces: Array, rate: float, duration: float) -> float:
    """Estimate the standard deviation of the force's mean over some time, whatever the noise's correlation.

    Args:
        forces: Readings at rest, (N, 3) [N].
        rate: Rate of the readings [Hz].
        duration: Time over which the mean is taken, shorter than that of the readings [s].

    Returns:
        The deviation, mean square of the axes [N].
    """
    n = max(round(duration * rate), 1)
    centred = forces - forces.mean(axis=0)
    means = np.stack([np.convolve(axis, np.full(n, 1.0 / n), mode="valid") for axis in centred.T])
    # The mean of all readings, which was subtracted, holds a share of each window's own deviation.
    return float(np.sqrt(np.mean(means**2) / (1.0 - n / len(forces))))


def onset(heights: Array, forces: Array) -> float:
    """Find where a force began to rise, by the least squares of a force that is constant above and linear below.

    Args:
        heights: Falling heights, (N,) [m]; the last one is where the contact was detected.
        forces: Upward forces, (N,) [N].

    Returns:
        The height at which the line begins [m].
    """
    near = heights < heights[-1] + SLOPE_RANGE
    x, f = heights[near], forces[near]
    best, where = np.inf, float(heights[-1])
    for begin in np.arange(x[-1] + 0.0001, x[-1] + 0.75 * SLOPE_RANGE, 0.0001):
        ramp = np.maximum(begin - x, 0.0)
        A = np.column_stack([np.ones_like(x), ramp])
        solution, *_ = np.linalg.lstsq(A, f, rcond=None)
        rest = float(np.sum((A @ solution - f) ** 2))
        if solution[1] > 0.0 and rest < best:
            best, where = rest, float(begin)
    return where
