"""The forecast of the nail between two measurements: it asks for a measurement where it must, and seldom."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from toolee_robot.control.contact import ContactVerdict, Meeting
from toolee_robot.tasks.hammering.nail_forecast import DISAGREEMENT, LATENESS, LONGEST, NailForecast

FLUSH, SPEED, RATE, DELAY = 0.001, 1.2, 500.0, -0.015


def drive(
    forecast: NailForecast, height: float, depths: list[float], rng: np.random.Generator
) -> tuple[list[int], list[float]]:
    """Strike with the given depths; returns the numbers of the measured strikes and the forecast's errors."""
    forecast.measured(height)
    measured, errors = [], []
    for number, depth in enumerate(depths, start=1):
        errors.append(forecast.height - height)
        delay = DELAY - rng.uniform(0.0, SPEED / RATE)
        met = ContactVerdict(Meeting.EXPECTED, height - forecast.height + delay)
        height = max(height - depth, 0.0)
        if forecast.struck(met, SPEED):
            measured.append(number)
            forecast.measured(height)
    return measured, errors


def depths(first: float, decay: float, n: int) -> list[float]:
    return [first * decay**k for k in range(n)]


@given(st.floats(0.001, 0.004), st.floats(0.85, 1.0), st.integers(0, 2**32 - 1))
def test_a_nail_is_measured_after_its_first_strike_and_before_it_is_taken_for_flush(
    first: float, decay: float, seed: int
) -> None:
    forecast = NailForecast(FLUSH, RATE)
    measured, errors = drive(forecast, 0.020, depths(first, decay, 12), np.random.default_rng(seed))
    assert measured[0] == 1
    assert np.diff([0, *measured]).max() <= LONGEST + 1
    assert forecast.height > FLUSH or forecast.unmeasured == 0, "flush by forecast alone"
    # What a contact disagrees with is measured at once.
    assert np.abs(errors).max() < (LATENESS + 1.0) * SPEED / RATE + DISAGREEMENT + first


def test_most_strikes_of_a_usual_nail_need_no_measurement() -> None:
    usual = [0.00296, 0.00243, 0.00219, 0.00182, 0.00147, 0.00164, 0.00153, 0.00138, 0.00106, 0.0012, 0.0013]
    forecast = NailForecast(FLUSH, 125.0)
    measured, _ = drive(forecast, 0.020, usual, np.random.default_rng(0))
    assert len(measured) <= 4


@pytest.mark.parametrize("off", [-0.012, 0.012])
def test_a_contact_elsewhere_is_measured_and_said(off: float) -> None:
    forecast = NailForecast(FLUSH, RATE)
    drive(forecast, 0.020, [0.002], np.random.default_rng(0))
    assert not forecast.struck(ContactVerdict(Meeting.EXPECTED, DELAY), SPEED)
    assert forecast.struck(ContactVerdict(Meeting.EXPECTED, DELAY + off), SPEED)
    assert ("above" if off > 0 else "below") in forecast.surprise


def test_progress_is_that_of_one_strike() -> None:
    forecast = NailForecast(FLUSH, RATE)
    drive(forecast, 0.020, [0.003], np.random.default_rng(0))
    for _ in range(2):
        forecast.struck(ContactVerdict(Meeting.EXPECTED, DELAY), SPEED)
    assert forecast.measured(0.013) == pytest.approx(0.002)
