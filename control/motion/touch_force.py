"""The force of a guarded touch: threshold, window and speeds by the noise at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import ZERO_TIME, Arm, Clock
from toolee_robot.station import StrikeConfig

WINDOW_WAY, LONGEST_WINDOW = 0.00144, 0.3
"""Travel over which the force of a touch is averaged [m]: 48 ms, six readings of a CB3, at 0.03 m/s; and the longest
time for it [s]."""
QUIET = 1.0
"""Standard deviation of the force up to which a touch goes at `strike.touch_speed` [N]; with more, slower."""
SLOWEST = 0.2
"""Least speed of a touch as a share of `strike.touch_speed`."""
PRECISE, RELEASE = 0.6, 3e-6
"""Standard deviation of the window's mean force up to which the way down tells where the force began [N]; with more,
the face is released at a speed of this much [m/s] for every N/m of stiffness, times (QUIET / standard deviation)^2: the
deviation of the height found falls with the root of stiffness and time. With a CB3's noise and a hand that yields by 1
mm to 6.5 N that are 1.4 mm/s and 0.3 mm of deviation, 0.2 mm with what the other releases tell. At 1 mm/s they are 0.2
and 0.13 mm (360 drawn releases each), for 1.7 s more."""
RELEASE_SPEEDS = 0.0007, 0.0014
"""Least and largest speed of a release [m/s]."""
SURE_STIFFNESS, FASTER = 0.12, 2.0
"""Standard deviation of the stiffness, as a share of it, to which two releases determine it; and how many times as
fast the next releases are. With one zero for nail and wood the protrusion then has a deviation of 0.29 mm, and a
release takes 1.3 s. Slow releases that were each zeroed: 0.26 mm and 2.6 s (600 drawn measurements each)."""
SIGMAS = 4.5
"""Threshold of a contact in standard deviations of the window's mean force: one touch in some fifty with a CB3's noise
is a phantom, which is recognised."""
MAX_FACTOR = 1.5
"""The noise may raise the threshold to this multiple of `strike.touch_force`; with more, nothing is touched."""
CONFIRM_SHARE = 0.5
"""A contact is sure when at rest at least this share of the threshold still presses."""
MAX_PHANTOMS = 3
"""Number of contacts in one touch that were none after which the force is not to be relied on."""
LARGEST_OFFSET = 20.0
"""Largest force at rest that is taken for an offset of the reading [N], twice the accuracy that a CB3 is said to have.
Beyond it the arm touches something, or its payload is wrong."""


@dataclass(frozen=True)
class TouchSettings:
    """How to touch with the force's present noise.

    Attributes:
        force: Mean force that counts as a contact [N].
        window: Averaging window [s].
        speed: Speed of the touch [m/s].
        release: Speed of the release after it by the stiffness [m/s per N/m]; None where the touch itself is precise
            enough.
        variance: Variance of the force's noise that independent readings would have for a mean as uncertain [N^2].
        largest: Mean force that may count as a contact at most [N].
    """

    force: float
    window: float
    speed: float
    release: float | None
    variance: float
    largest: float

    @property
    def forces(self) -> tuple[float, ...]:
        """Mean force that counts as a contact [N], at first and each time that the touch has to go on.

        What feigned a contact may last. And the harder the face presses, the better is its height known.
        """
        return tuple(np.geomspace(self.force, max(self.largest, self.force), MAX_PHANTOMS).tolist())

    def release_speed(self, stiffness: float, deviation: float = np.inf) -> float:
        """Speed of a release.

        Args:
            stiffness: Stiffness of tool, hand and what the face presses on [N/m].
            deviation: Its standard deviation, as a share of it.

        Returns:
            The speed [m/s].
        """
        assert self.release is not None, "a quiet arm releases nothing"
        faster = FASTER if deviation <= SURE_STIFFNESS else 1.0
        return faster * float(np.clip(self.release * stiffness, *RELEASE_SPEEDS))


def wrenches_at_rest(arm: Arm, clock: Clock, duration: float) -> Array:
    """Read the wrench of an arm at rest.

    Args:
        arm: The arm.
        clock: The station's clock.
        duration: Time over which it is read [s].

    Returns:
        The readings, one a cycle, (N, 6) [N, Nm], `base` axes.

    Raises:
        DeviceError: The arm does not answer.
    """
    readings = []
    for _ in range(max(round(duration * arm.rate), 1)):
        clock.sleep(1.0 / arm.rate)
        readings.append(arm.state().wrench)
    return np.array(readings)


def forces_at_rest(arm: Arm, clock: Clock, duration: float) -> Array:
    """Read the force of an arm at rest; see `wrenches_at_rest`.

    Args:
        arm: The arm.
        clock: The station's clock.
        duration: Time over which it is read [s].

    Returns:
        The readings, one a cycle, (N, 3) [N], `base` axes.

    Raises:
        DeviceError: The arm does not answer.
    """
    return wrenches_at_rest(arm, clock, duration)[:, :3]


def check_offset(wrench: Array) -> None:
    """Check that what an arm reads at rest can be an offset of its reading.

    Args:
        wrench: Force [N] and torque [Nm] at rest, (6,).

    Raises:
        DeviceError: The force is larger than `LARGEST_OFFSET`.
    """
    if (force := float(np.linalg.norm(wrench[:3]))) > LARGEST_OFFSET:
        raise DeviceError(
            f"the arm feels {force:.0f} N at rest, more than the sensor's offset. Free what it touches or correct "
            "the payload, then zero the force again",
            code="device.wrench_too_large",
        )


def touch_settings(forces: Array, rate: float, strike: StrikeConfig) -> TouchSettings:
    """Choose threshold, window and speeds of a touch by the noise of the force.

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
    deviation = deviation_of_mean(forces, rate, window)
    needed = SIGMAS * deviation * float(np.sqrt(1.0 + window / ZERO_TIME))
    if needed > MAX_FACTOR * strike.touch_force:
        raise DeviceError(
            f"the force at rest is so noisy (standard deviation {sigma:.1f} N) that a sure contact needs "
            f"{needed:.0f} N, more than strike.touch_force {strike.touch_force:g} N: no touch. Check the payload, "
            "wait until nothing swings, or raise it as far as the hand can bear",
            code="device.force_noise",
        )
    noisy = sigma > QUIET and deviation > PRECISE
    release = RELEASE * (QUIET / sigma) ** 2 if noisy else None
    variance = max(round(window * rate), 1) * deviation**2
    largest = MAX_FACTOR * strike.touch_force
    return TouchSettings(max(strike.touch_force, needed), window, speed, release, variance, largest)


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
