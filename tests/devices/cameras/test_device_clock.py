"""A device's clock on the host's: bounds that hold for every drift within 100 ppm and every jitter of the delay."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from toolee_robot.devices.cameras.stream import MAX_DRIFT, DeviceClock

PERIOD = 1 / 30


@examples(60)
@given(
    drift=st.floats(-100e-6, 100e-6),
    offset=st.floats(-1e5, 1e5),
    least=st.floats(0.0, 0.05),
    jitter=st.floats(0.0, 0.1),
    seed=st.integers(0, 2**31),
)
def test_a_stamp_is_late_by_the_least_delay_and_little_more(
    drift: float, offset: float, least: float, jitter: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    exposed = 100.0 + PERIOD * np.arange(600) + 0.01 * rng.random(600)
    extra = jitter * rng.random(600) ** 2
    arrivals = np.maximum.accumulate(exposed + least + extra)
    clock = DeviceClock()
    error = np.array(
        [clock.convert((1 + drift) * t + offset, a) - (t + least) for t, a in zip(exposed, arrivals, strict=True)]
    )
    extra = arrivals - exposed - least
    slack = 1e-6 + 1e-9 * abs(offset)
    # Between the clocks and the truth: what they drift apart since the image with the least delay.
    passed = exposed[:, None] - exposed[None, :]
    bound = np.where(passed >= 0, extra[None, :] + 2 * MAX_DRIFT * (passed + least + jitter), np.inf).min(axis=1)
    assert np.all(error <= bound + slack)
    assert np.all(error >= -2 * MAX_DRIFT * (least + jitter) - slack), "never before the exposure and the least delay"
    assert np.all(error + exposed + least <= arrivals + slack), "never after the arrival"


def test_it_is_within_a_millisecond_under_ten_minutes_of_jitter_and_drift() -> None:
    rng = np.random.default_rng(1)
    exposed = PERIOD * np.arange(18_000)
    arrivals = np.maximum.accumulate(exposed + 0.025 + rng.exponential(0.008, 18_000))
    clock = DeviceClock()
    stamps = 1e4 + exposed * (1 - 80e-6)
    error = np.array([clock.convert(s, a) for s, a in zip(stamps, arrivals, strict=True)]) - exposed - 0.025
    assert np.abs(error[30:]).max() < 2e-3
    assert np.median(np.abs(error)) < 0.7e-3


def test_a_stream_that_becomes_late_stays_late() -> None:
    clock = DeviceClock()
    for n in range(100):
        clock.convert(PERIOD * n, PERIOD * n + 0.02)
    for n in range(100, 1900):
        stamp = clock.convert(PERIOD * n, PERIOD * n + 0.52)
    assert abs(stamp - (PERIOD * 1899 + 0.02)) < 0.02


def test_a_clock_that_jumps_ahead_is_seen() -> None:
    clock = DeviceClock()
    for n in range(100):
        clock.convert(PERIOD * n, PERIOD * n + 0.02)
    assert abs(clock.surplus(100 * PERIOD, 100 * PERIOD + 0.05) - 0.03) < 1e-4
    assert clock.surplus(100 * PERIOD + 1.0, 100 * PERIOD + 0.02) < -0.99
