"""Contact detection by force, with the noise, offset and drift that the force of a real arm has."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from tests.examples import examples
from toolee_robot.control.motion.contact_force import ContactForce, strike_guard
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard
from toolee_robot.station import sim_station

RATES = {"CB3": (125.0, 3.6, 0.02), "e-Series": (500.0, 1.5, 0.004)}
"""Rate [Hz], standard deviation [N] and correlation time [s] of the force."""


def noise(rng: np.random.Generator, generation: str, n: int) -> Array:
    rate, sigma, correlation = RATES[generation]
    keep = float(np.exp(-1.0 / (rate * correlation)))
    forces = np.empty((n, 3))
    forces[0] = rng.normal(0.0, sigma, 3)
    for k in range(1, n):
        forces[k] = keep * forces[k - 1] + rng.normal(0.0, sigma * np.sqrt(1.0 - keep**2), 3)
    return forces


def contacts(guard: ContactGuard, rate: float, forces: Array) -> list[int]:
    contact = ContactForce(guard, 1.0 / rate)
    return [k for k, force in enumerate(forces) if contact.add(force)]


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 12.0), st.floats(0.0, 60.0))
def test_neither_an_offset_nor_a_slow_drift_is_a_contact_and_a_step_is(seed: int, offset: float, drift: float) -> None:
    rng = np.random.default_rng(seed)
    direction, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    ramp = np.arange(100) / 125.0
    forces = offset * axis + drift * ramp[:, None] * direction
    guard = strike_guard(sim_station().strike, 0.5)
    assert not contacts(guard, 125.0, forces)
    assert contacts(guard, 125.0, np.vstack([forces, forces[-1] + 30.0 * direction])) == [100]


def test_without_a_baseline_the_absolute_force_counts() -> None:
    forces = np.tile([0.0, 0.0, 16.0], (5, 1))
    assert contacts(ContactGuard(15.0, averaging_window=0.024), 125.0, forces) == [2, 3, 4]


@pytest.mark.parametrize("generation", RATES)
@examples(20)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_noise_of_a_strike_is_no_contact_and_the_nail_is_one_within_two_cycles(generation: str, seed: int) -> None:
    rng, rate = np.random.default_rng(seed), RATES[generation][0]
    guard = strike_guard(sim_station().strike, 0.5, noise(rng, generation, round(rate)), rate)
    free = noise(rng, generation, round(0.5 * rate))
    assert not contacts(guard, rate, free)
    n = round(0.016 * rate)
    met = noise(rng, generation, len(free) + n)
    met[len(free) :] += [0.0, 0.0, 40.0]
    assert any(k >= len(free) for k in contacts(guard, rate, met))


def test_a_force_that_is_too_noisy_allows_no_strike() -> None:
    forces = np.random.default_rng(0).normal(0.0, 12.0, (125, 3))
    with raises(DeviceError, code="device.force_noise"):
        strike_guard(sim_station().strike, 0.5, forces, 125.0)
