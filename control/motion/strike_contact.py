"""Contact detection of a strike: a step of the force, with a threshold that bears the force's noise."""

from __future__ import annotations

import numpy as np

from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard
from toolee_robot.station import StrikeConfig

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
