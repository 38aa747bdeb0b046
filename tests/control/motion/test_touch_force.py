"""Threshold, window and speeds of a touch, by the noise of the force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.control.motion.cb3_noise import RATE, noise
from tests.examples import examples
from tests.rigs.job_rig import CONFIG
from toolee_robot.control.motion.touch_force import deviation_of_mean, touch_settings
from toolee_robot.errors import DeviceError


@given(sigma=st.floats(0.05, 4.0), correlation=st.floats(0.0, 0.03), seed=st.integers(0, 10_000))
@examples(60)
@example(sigma=4.0, correlation=0.02734375, seed=1)  # refused
def test_the_threshold_follows_from_the_noise_and_its_correlation(sigma: float, correlation: float, seed: int) -> None:
    rng = np.random.default_rng(seed)

    rest = noise(rng, 375, sigma, correlation)
    try:
        settings = touch_settings(rest, RATE, CONFIG.strike)
    except DeviceError:
        # Only noise whose mean over a window is larger than with the 3.6 N and 20 ms of a CB3 may be refused.
        assert sigma**2 * correlation > 3.6**2 * 0.02
        return
    assert CONFIG.strike.touch_force <= settings.force <= 1.5 * CONFIG.strike.touch_force
    assert settings.window * settings.speed == pytest.approx(0.00144)
    later = noise(rng, 20_000, sigma, correlation)
    n = round(settings.window * RATE)
    true = float(np.sqrt(np.mean(np.convolve(later[:, 0], np.full(n, 1 / n), mode="valid") ** 2)))
    assert 0.5 * true < deviation_of_mean(rest, RATE, settings.window) < 2.0 * true
    assert settings.force > 3.0 * true
    assert settings.release is None or settings.release_speed(1e9) < 0.25 * settings.speed
    assert settings.release is None or sigma > 0.9
