"""Contact detection by force: of guarded motions and of strikes."""

from __future__ import annotations

from collections import deque

import numpy as np

from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard
from toolee_robot.station import StrikeConfig


class ContactForce:
    """Detects a contact in the readings of one motion; a reading costs the same however long the windows are.

    Args:
        guard: What counts as a contact.
        period: Time between two readings [s].
    """

    def __init__(self, guard: ContactGuard, period: float) -> None:
        self._force = guard.force
        self._window = max(round(guard.averaging_window / period), 1)
        self._baseline = max(round(guard.baseline / period), 1) if guard.baseline > 0.0 else 0
        self._readings: deque[Array] = deque()
        self._newest, self._older = np.zeros(3), np.zeros(3)  # sums over window and baseline

    def add(self, force: Array) -> bool:
        """Add a reading.

        Args:
            force: Force at the flange, (3,) [N].

        Returns:
            Whether the newest readings are a contact.
        """
        readings, longest = self._readings, self._window + self._baseline
        readings.append(force)
        self._newest += force
        if len(readings) > self._window:
            self._newest -= readings[-self._window - 1]
            self._older += readings[-self._window - 1]
        if len(readings) > longest:
            self._older -= readings.popleft()
        if len(readings) < longest:
            return False
        step = self._newest / self._window
        if self._baseline:
            step -= self._older / self._baseline
        return float(step @ step) > self._force**2


STEP_WINDOW, STEP_BASELINE = 0.008, 0.05
"""Averaging window and baseline of a strike's contact detection [s]: one reading of a CB3 against six."""
SIGMAS = 5.5
"""Threshold of a strike's contact in standard deviations of an axis of its step: one strike in thousands ends early."""
MAX_FACTOR = 1.5
"""The noise may raise the threshold to this multiple of `strike.contact_force`; with more there are no strikes."""
ARMED_FROM = 0.5
"""Share of the time to the contact before which no force counts, because of the starting transients."""


def strike_guard(
    strike: StrikeConfig, contact_time: float, noise: Array | None = None, rate: float = 1.0
) -> ContactGuard:
    """Build the contact detection of a strike, whose threshold bears the noise of the force.

    Args:
        strike: Configured force of a contact.
        contact_time: When the strike should meet the nail, on its trajectory [s].
        noise: Readings of the force at rest, one a cycle, (N, 3) [N]; None if it was not measured.
        rate: Rate of these readings [Hz].

    Returns:
        The contact detection.

    Raises:
        DeviceError: The force is too noisy for the configured threshold.
    """
    needed = 0.0
    if noise is not None:
        window, baseline = (max(round(time * rate), 1) for time in (STEP_WINDOW, STEP_BASELINE))
        rows = np.lib.stride_tricks.sliding_window_view(noise, window + baseline, axis=0).swapaxes(1, 2)
        steps = rows[:, baseline:].mean(axis=1) - rows[:, :baseline].mean(axis=1)
        needed = SIGMAS * float(np.sqrt(np.mean(steps**2)))
    if needed > MAX_FACTOR * strike.contact_force:
        raise DeviceError(
            f"at rest the force varies so much that only a step of {needed:.0f} N would be a sure contact in a strike, "
            f"strike.contact_force is {strike.contact_force:g} N: no strike. Check the payload, wait until nothing "
            "swings, or raise it as far as hand and tool can bear",
            code="device.force_noise",
        )
    return ContactGuard(max(strike.contact_force, needed), ARMED_FROM * contact_time, STEP_WINDOW, STEP_BASELINE)
