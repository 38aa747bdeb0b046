"""Threshold, window and speeds of a touch, by the noise of the force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.control.motion.cb3_noise import NOISE, RATE, noise
from tests.errors import raises
from tests.examples import examples, seldom
from tests.rigs.job_rig import CONFIG
from toolee_robot.control.motion.contact_force import ContactForce, Course, Releases, onset, strike_guard, swing_sway
from toolee_robot.control.motion.touch_force import TouchSettings, deviation_of_mean, touch_settings
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import ZERO_TIME, ContactGuard
from toolee_robot.sim_backend.ur_controller.profile import CB3
from toolee_robot.station import sim_station
from toolee_robot.tasks.hammering.touch import FREE, UNSURE


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


RATES = {"CB3": (125.0, 3.6, 0.02), "e-Series": (500.0, 1.5, 0.004)}
"""Rate [Hz], standard deviation [N] and correlation time [s] of the force."""


def noise_of_contact_force(rng: np.random.Generator, generation: str, n: int) -> Array:
    rate, sigma, correlation = RATES[generation]
    keep = float(np.exp(-1.0 / (rate * correlation)))
    forces = np.empty((n, 3))
    forces[0] = rng.normal(0.0, sigma, 3)
    for k in range(1, n):
        forces[k] = keep * forces[k - 1] + rng.normal(0.0, sigma * np.sqrt(1.0 - keep**2), 3)
    return forces


def contacts(guard: ContactGuard, rate: float, forces: Array) -> list[int]:
    contact = ContactForce(guard, 1.0 / rate)
    return [k for k, force in enumerate(forces) if contact.add(force, np.inf)]


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
    guard = strike_guard(sim_station().strike, 0.5, noise_of_contact_force(rng, generation, round(rate)), rate)
    free = noise_of_contact_force(rng, generation, round(0.5 * rate))
    assert not contacts(guard, rate, free)
    n = round(0.016 * rate)
    met = noise_of_contact_force(rng, generation, len(free) + n)
    met[len(free) :] += [0.0, 0.0, 40.0]
    assert any(k >= len(free) for k in contacts(guard, rate, met))


def test_a_force_that_is_too_noisy_allows_no_strike() -> None:
    forces = np.random.default_rng(0).normal(0.0, 12.0, (125, 3))
    with raises(DeviceError, code="device.force_noise"):
        strike_guard(sim_station().strike, 0.5, forces, 125.0)


@pytest.mark.parametrize(("stiffness", "share"), [(4e3, 0.99), (6.5e3, 0.99), (1e4, 0.998), (2e4, 1.0), (5e4, 1.0)])
def test_the_onset_of_a_noisy_force_is_found(stiffness: float, share: float) -> None:
    """At the speed that a touch has with this noise, up to where the mean force of a window passes 9 N."""
    rng, speed, errors = np.random.default_rng(1), 0.03 / NOISE, []
    heights = np.arange(0.015, -0.015, -speed / RATE)
    n = round(0.00144 / speed * RATE)
    for _ in range(500):
        begin, offset = rng.uniform(-0.002, 0.002), rng.uniform(-2.0, 2.0)
        forces = stiffness * np.maximum(begin - heights, 0.0) + rng.normal(0.0, NOISE, len(heights))
        mean = np.convolve(forces, np.full(n, 1 / n))[: len(heights)]
        end = int(np.argmax((mean > 9.0) & (heights < begin))) + 1
        rise = onset(Course(heights[:end], forces[:end] + offset, NOISE**2))
        assert rise is not None
        errors.append(rise.height - begin)
    assert np.mean(np.abs(errors) < 0.001) >= share
    assert np.std(errors) < 0.0004 * np.sqrt(4e3 / stiffness)


def _settings(rng: np.random.Generator) -> TouchSettings:
    """By a CB3's noise at rest."""
    return touch_settings(noise(rng, 375, NOISE, CB3.force.correlation), RATE, CONFIG.strike)


def _release(
    rng: np.random.Generator,
    settings: TouchSettings,
    begin: float,
    force: float,
    stiffness: float,
    offset: float = 0.0,
    deviation: float = np.inf,
    zero: float | None = None,
) -> Course:
    """Forces of a CB3 that was zeroed before the touch, at a release of a nail that is pressed with a force [N]."""
    speed = settings.release_speed(stiffness, deviation)
    assert deviation < np.inf or 0.0007 <= speed <= 0.0014
    heights = np.arange(begin - force / stiffness, begin + FREE, speed / RATE)
    zeros = round(ZERO_TIME * RATE)
    readings = offset + noise(rng, zeros + len(heights), NOISE, CB3.force.correlation)[:, 0]
    zero = float(np.mean(readings[:zeros])) if zero is None else zero
    forces = readings[zeros:] - zero + stiffness * np.maximum(begin - heights, 0.0)
    return Course(heights, forces, settings.variance, zeros)


def test_a_slow_release_finds_the_onset_in_a_cb3s_noise_or_says_that_it_is_unsure() -> None:
    """Of hands that yield as the simulated one, and stiffer ones, pressed with 12 to 23 N."""
    draw, errors, stiffnesses = np.random.default_rng(4), [], []
    for seed in range(1000):
        begin, stiffness, force = draw.uniform(-0.001, 0.001), draw.uniform(6.5e3, 2e4), draw.uniform(11.7, 23.0)
        rng, offset = np.random.default_rng(seed), draw.uniform(-7.0, 7.0)
        rise = onset(_release(rng, _settings(rng), begin, force, stiffness, offset))
        assert rise is not None
        errors.append((rise.height - begin, rise.deviation))
        stiffnesses.append(rise.stiffness / stiffness)
    error, deviation = np.transpose(errors)
    sure = deviation <= UNSURE
    assert np.mean(sure) > 0.97
    np.testing.assert_allclose(error[sure], 0.0, atol=0.001)
    np.testing.assert_allclose(np.array(stiffnesses)[sure], 1.0, rtol=0.75)
    assert np.std(error) < 0.00016
    assert np.std(error / deviation) == pytest.approx(1.0, abs=0.1), "the deviation is that of the errors"


@pytest.mark.parametrize(("seed", "stiffness"), [(640, 14_625.0), (128, 14_489.0)])
def test_a_release_of_which_the_best_line_is_wrong_is_found_all_the_same(seed: int, stiffness: float) -> None:
    """Drawn by a test of that line: 1.0 mm off, and a stiffness of 1.9 times the true one."""
    rng = np.random.default_rng(seed)
    rise = onset(_release(rng, _settings(rng), 0.0, 0.0018 * 6.5e3, stiffness))
    assert rise is not None
    assert rise.height == pytest.approx(0.0, abs=0.0008)
    assert rise.stiffness == pytest.approx(stiffness, rel=0.7)


@pytest.mark.parametrize(("n", "share"), [(2, 1.0), (4, 0.95), (8, 0.9)])
def test_releases_tell_each_other_the_stiffness_and_their_heights_are_better_for_it(n: int, share: float) -> None:
    """Nails with n releases in a CB3's noise, of hands whose stiffness differs by 5 % from one to the next."""
    rng, alone, together = np.random.default_rng(3), [], []
    settings = _settings(rng)
    for _ in range(100):
        nominal, releases, begins, numbers = rng.uniform(4.5e3, 1e4), Releases(), [], []
        for _ in range(n):
            stiffness, begin = nominal * rng.normal(1.0, 0.05), rng.uniform(-0.001, 0.001)
            course = _release(rng, settings, begin, 12.0, stiffness)
            rise = onset(course)
            assert rise is not None
            numbers.append(releases.add(course, rise.stiffness))
            begins.append(begin)
            alone.append(rise.height - begin)
        together += [releases.height(number) - begin for number, begin in zip(numbers, begins, strict=True)]
    print(f"\nstandard deviation alone {np.std(alone) * 1e3:.2f} mm, together {np.std(together) * 1e3:.2f} mm")
    assert np.std(together) < share * np.std(alone)
    assert np.max(np.abs(together)) < 0.001


@pytest.mark.parametrize("faster", seldom(True, False))
def test_a_protrusion_is_as_sure_by_faster_releases_with_a_common_zero(faster: bool) -> None:
    """The first two releases are slow; of the next six, two tell a height. `pytest -s --nightly` prints the figures."""
    rng, errors, times = np.random.default_rng(5), [], []
    settings = _settings(rng)
    for _ in range(200):
        nominal, releases, heights, zero = rng.uniform(4.5e3, 1e4), Releases(), [], 0.0
        for k in range(8):
            stiffness, begin, force = nominal * rng.normal(1.0, 0.04), rng.uniform(-0.001, 0.001), rng.normal(14.0, 2.0)
            if k % 2 == 0:
                zero = float(np.mean(noise(rng, round(ZERO_TIME * RATE), NOISE, CB3.force.correlation)[:, 0]))
            sure = releases.belief().deviation if faster else np.inf
            course = _release(rng, settings, begin, max(force, 9.0), stiffness, 0.0, sure, zero if faster else None)
            rise = onset(course)
            assert rise is not None
            heights.append((releases.add(course, rise.stiffness), begin))
            times += [len(course.heights) / RATE] if k > 1 else []
        off = [releases.height(number) - begin for number, begin in heights]
        errors += [off[k] - off[k + 1] - (off[0] - off[1]) for k in (2, 4, 6)]
    print(f"\nfaster {faster}: deviation {np.std(errors) * 1e3:.2f} mm, a release {np.mean(times):.1f} s")
    assert np.std(errors) < 0.0004
    assert np.mean(times) < (1.6 if faster else 3.0)


def test_a_release_that_was_none_tells_nothing() -> None:
    heights = np.arange(-0.002, 0.002, 0.00001)
    good, bad = (Course(heights, k * np.maximum(-heights, 0.0), 65.0) for k in (5e3, 2e4))
    releases = Releases()
    first = releases.add(good, 5e3)
    alone = releases.height(first)
    releases.drop(releases.add(bad, 2e4))
    assert releases.belief().stiffness == 5e3
    assert releases.height(first) == alone


def test_a_force_that_falls_on_the_way_down_has_no_onset() -> None:
    heights = np.arange(0.008, -0.002, -0.0001)
    assert onset(Course(heights, 500.0 * heights, 1.0)) is None


@examples(60)
@given(
    frequency=st.floats(5.0, 300.0),
    brake=st.floats(15.0, 30.0),
    begins=st.floats(0.28, 0.36),
    ramp=st.floats(0.02, 0.06),
)
def test_a_tool_that_sways_in_the_hand_on_an_undamped_spring_is_no_contact(
    frequency: float, brake: float, begins: float, ramp: float
) -> None:
    """The swing speeds up at 5 m/s² and brakes before the contact; the spring has `frequency` in rad/s."""
    step, contact, mass, period = 0.0005, 0.42, 1.0, 0.008
    fine = np.arange(0.0, contact, step)
    base = 5.0 * np.clip(fine / 0.08, 0.0, 1.0) - (5.0 + brake) * np.clip((fine - begins) / ramp, 0.0, 1.0)
    place = np.cumsum(np.cumsum(base)) * step**2
    lag, speed, pull = 0.0, 0.0, []
    for a in base:
        own = -(frequency**2) * lag
        pull.append(mass * (own - a))
        speed += (own - a) * step
        lag += speed * step
    cycle = round(period / step)
    forces = np.zeros((len(fine) // cycle, 3))
    forces[:, 0] = np.array(pull)[: len(forces) * cycle].reshape(-1, cycle).mean(axis=1)
    times = fine[::8]
    face = np.zeros((len(times), 3))
    face[:, 0] = place[::8]
    early = 0.024
    guard = strike_guard(sim_station().strike, contact, sway=swing_sway(mass, times, face, contact, early))
    force = ContactForce(guard, period)
    felt = [(k + 1) * period for k, reading in enumerate(forces) if force.add(reading, (k + 1) * period)]
    away = np.interp(felt, fine, place[-1] - place)
    assert np.all(away <= early), "what is felt at most counts as the nail"
    assert any(force.add(forces[-1] + [0.0, 20.0, 0.0], contact) for _ in range(2)), "the nail is felt at once"
