"""The noise of a CB3's force."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import CB3

NOISE, RATE = CB3.force.noise[0], 125.0
"""Standard deviation [N] and rate of the readings [Hz]."""


def noise(rng: np.random.Generator, n: int, sigma: float, correlation: float) -> Array:
    """Readings with a standard deviation [N] and a correlation time [s], (n, 3) [N]."""
    keep = np.exp(-1 / (RATE * correlation)) if correlation > 1e-3 else 0.0
    fresh = sigma * np.sqrt(1 - keep**2) * rng.normal(size=(n + 100, 3))
    return np.asarray(lfilter([1.0], [1.0, -keep], fresh, axis=0)[100:])
