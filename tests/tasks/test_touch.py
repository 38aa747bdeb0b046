"""Guarded touches with the force of a CB3: noisy, offset, drifting; where they end, and when they are refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.signal import lfilter

from tests.errors import raises
from tests.examples import examples
from tests.tasks.noisy_arm import Rig
from toolee_robot.errors import DeviceError
from toolee_robot.faults.rigs.job_rig import CONFIG, Bench
from toolee_robot.frames import Array
from toolee_robot.hal import ZERO_TIME
from toolee_robot.motion.onset import Course, Releases, onset
from toolee_robot.motion.touch_force import MAX_PHANTOMS, deviation_of_mean, touch_settings
from toolee_robot.sim_backend.devices.reading_errors import ReadingErrors
from toolee_robot.sim_backend.ur_controller.profile import CB3
from toolee_robot.types import ArmModel, Payload

NOISE, RATE = CB3.force.noise[0], 125.0


def noise(rng: np.random.Generator, n: int, sigma: float, correlation: float) -> Array:
    """Readings with a standard deviation [N] and a correlation time [s], (n, 3) [N]."""
    keep = np.exp(-1 / (RATE * correlation)) if correlation > 1e-3 else 0.0
    fresh = sigma * np.sqrt(1 - keep**2) * rng.normal(size=(n + 100, 3))
    return np.asarray(lfilter([1.0], [1.0, -keep], fresh, axis=0)[100:])


def touches(bench: Bench, seeds: range, each: int) -> Array:
    """Errors of touches against the simulated nail [m]: `each` for every seed of noise, offset and drift."""
    rng, errors, motions = np.random.default_rng(seeds.start), [], 0
    for seed in seeds:
        bench.reset()
        rig = Rig(bench, seed)
        errors += [rig.error(float(over)) for over in rng.uniform(0.006, 0.020, each)]
        motions += rig.log.motions.count("touch the nail")
    found = np.array(errors)
    print(
        f"\n{len(found)} touches: error {np.median(found) * 1e3:+.2f} mm in the median, {np.min(found) * 1e3:+.2f} to "
        f"{np.max(found) * 1e3:+.2f} mm; {motions - len(found)} phantoms that were recognised"
    )
    return found


@pytest.mark.sim(seconds=10)
def test_touches_with_a_cb3s_force_end_on_the_nail(bench: Bench) -> None:
    assert np.all(np.abs(touches(bench, range(1, 2), each=3)) < 1e-3)


@pytest.mark.nightly
@pytest.mark.sim(seconds=900)
def test_a_hundred_touches_of_a_hundred_end_within_a_millimetre(bench: Bench) -> None:
    errors = touches(bench, range(100, 120), each=5)
    assert np.sum(np.abs(errors) < 1e-3) == len(errors) == 100, errors


@pytest.mark.sim(seconds=10)
def test_a_force_too_noisy_for_the_threshold_is_refused(bench: Bench) -> None:
    rig = Rig(bench, 2, scale=2.5)
    before = bench.sim.world.robot.arm_state()[0]
    with raises(DeviceError, code="device.force_noise"):
        rig.touch.prepare()
    assert np.allclose(bench.sim.world.robot.arm_state()[0], before, atol=1e-3), "nothing moved"


class Dragging(ReadingErrors):
    """Errors of a wrench that feels a force out of the wood [N] whenever the joints move."""

    def __init__(self, force: float) -> None:
        super().__init__(ArmModel.UR10, 0.0, 0, 1.0 / RATE)
        self._error = np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])

    def step(self, q_target: Array, q: Array, qd: Array, payload: Payload) -> Array:  # noqa: ARG002
        return self._error if np.abs(qd).max() > 0.002 else np.zeros(6)


@pytest.mark.sim(seconds=10)
def test_what_feigns_a_contact_as_long_as_the_face_moves_is_touched_through(bench: Bench) -> None:
    rig = Rig(bench, seed=0, scale=0.0)
    bench.arm._sensor._errors = Dragging(9.0)
    assert abs(rig.error(0.010)) < 1e-3
    assert 1 < rig.log.motions.count("touch the nail") <= MAX_PHANTOMS


@pytest.mark.sim(seconds=10)
def test_what_feigns_a_contact_with_more_than_a_touch_may_press_ends_it(bench: Bench) -> None:
    rig = Rig(bench, seed=0, scale=0.0)
    bench.arm._sensor._errors = Dragging(14.0)
    with raises(DeviceError, code="device.force_noise") as ended:
        rig.error(0.010)
    assert "rose above 8 N, and 12 N at last, while the nail" in str(ended.value)
    assert rig.log.motions.count("touch the nail") == MAX_PHANTOMS


def test_a_face_that_leans_against_something_is_not_zeroed(bench: Bench) -> None:
    """Zeroed while touching, the force of the nail would be gone, and the next touch would press twice as hard."""
    rig = Rig(bench, 3, scale=0.0)
    rig.go_over(0.006)
    assert rig.touch.prepare()
    assert rig.touch.lower("nail", 0.016) is not None
    pressing = bench.arm.state().wrench[2]
    assert pressing > CONFIG.strike.touch_force
    assert not rig.touch.prepare()
    assert bench.arm.state().wrench[2] == pytest.approx(pressing, abs=1.0)


@pytest.mark.sim(seconds=10)
@pytest.mark.parametrize(("scale", "kept"), [(0.0, True), (1.0, False)])
def test_a_zero_that_still_holds_is_kept_on_a_quiet_arm_only(bench: Bench, scale: float, kept: bool) -> None:
    rig = Rig(bench, 4, scale=scale)
    rig.go_over(0.010)
    assert rig.touch.prepare()
    begin = bench.sim.world.time
    assert rig.touch.prepare()
    assert (bench.sim.world.time - begin < ZERO_TIME) == kept


@pytest.mark.sim(seconds=10)
def test_a_zero_from_which_the_force_has_drifted_is_taken_anew(bench: Bench) -> None:
    rig = Rig(bench, 5, scale=0.0)
    rig.go_over(0.010)
    assert rig.touch.prepare()
    bench.arm._sensor.offset[:3] += [0.0, 0.0, 3.0]
    assert rig.touch.prepare()
    assert np.linalg.norm(rig.motions.forces(0.1).mean(axis=0)) < 0.5


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


@pytest.mark.parametrize(("stiffness", "share"), [(4e3, 0.99), (6.5e3, 0.99), (1e4, 0.998), (2e4, 1.0), (5e4, 1.0)])
def test_the_onset_of_a_noisy_force_is_found(stiffness: float, share: float) -> None:
    """At the speed that a touch has with this noise, up to where the mean force of a window passes 9 N.

    A share of the touches is within 1 mm: at 4 kN/m those are 2.8 standard deviations of what the noise leaves.
    """
    rng, speed, errors = np.random.default_rng(1), 0.03 / NOISE, []
    heights = np.arange(0.015, -0.015, -speed / RATE)
    n = round(0.00144 / speed * RATE)
    for _ in range(500):
        begin, offset = rng.uniform(-0.002, 0.002), rng.uniform(-2.0, 2.0)
        forces = stiffness * np.maximum(begin - heights, 0.0) + rng.normal(0.0, NOISE, len(heights))
        mean = np.convolve(forces, np.full(n, 1 / n))[: len(heights)]
        end = int(np.argmax((mean > 9.0) & (heights < begin))) + 1
        rise = onset(Course(heights[:end], forces[:end] + offset))
        assert rise is not None
        errors.append(rise.height - begin)
    assert np.mean(np.abs(errors) < 0.001) >= share
    assert np.std(errors) < 0.0004 * np.sqrt(4e3 / stiffness)


@given(
    begin=st.floats(-0.001, 0.001),
    depth=st.floats(0.0018, 0.0035),
    stiffness=st.floats(6.5e3, 2e4),
    offset=st.floats(-7.0, 7.0),
    seed=st.integers(0, 10_000),
)
@examples(20)
def test_a_slow_release_finds_the_onset_in_a_cb3s_noise(
    begin: float, depth: float, stiffness: float, offset: float, seed: int
) -> None:
    """Noise correlated as a CB3's, zeroed before the touch; hands that yield as the simulated one, and stiffer ones."""
    rng = np.random.default_rng(seed)
    settings = touch_settings(noise(rng, 375, NOISE, CB3.force.correlation), RATE, CONFIG.strike)
    depth *= 6.5e3 / stiffness
    speed = settings.release_speed(stiffness)
    assert 0.0005 <= speed <= 0.001
    heights = np.arange(begin - depth, begin + 0.002, speed / RATE)
    zeros = round(ZERO_TIME * RATE)
    readings = offset + noise(rng, zeros + len(heights), NOISE, CB3.force.correlation)[:, 0]
    forces = readings[zeros:] - np.mean(readings[:zeros]) + stiffness * np.maximum(begin - heights, 0.0)
    rise = onset(Course(heights, forces, zeros))
    assert rise is not None
    assert rise.height == pytest.approx(begin, abs=0.001)
    assert rise.stiffness == pytest.approx(stiffness, rel=0.75)


@pytest.mark.parametrize(("n", "share"), [(2, 1.0), (4, 0.95), (8, 0.9)])
def test_releases_tell_each_other_the_stiffness_and_their_heights_are_better_for_it(n: int, share: float) -> None:
    """Nails with n releases in a CB3's noise, of hands whose stiffness differs by 5 % from one to the next."""
    rng, alone, together = np.random.default_rng(3), [], []
    settings = touch_settings(noise(rng, 375, NOISE, CB3.force.correlation), RATE, CONFIG.strike)
    for _ in range(100):
        nominal, releases, begins, numbers = rng.uniform(4.5e3, 1e4), Releases(), [], []
        releases.variance = settings.variance
        for _ in range(n):
            stiffness, begin = nominal * rng.normal(1.0, 0.05), rng.uniform(-0.001, 0.001)
            heights = np.arange(begin - 12.0 / stiffness, begin + 0.002, settings.release_speed(stiffness) / RATE)
            zeros = round(ZERO_TIME * RATE)
            readings = noise(rng, zeros + len(heights), NOISE, CB3.force.correlation)[:, 0]
            forces = readings[zeros:] - np.mean(readings[:zeros]) + stiffness * np.maximum(begin - heights, 0.0)
            course = Course(heights, forces, zeros)
            rise = onset(course)
            assert rise is not None
            numbers.append(releases.add(course, rise.stiffness))
            begins.append(begin)
            alone.append(rise.height - begin)
        together += [releases.height(number) - begin for number, begin in zip(numbers, begins, strict=True)]
    print(f"\nstandard deviation alone {np.std(alone) * 1e3:.2f} mm, together {np.std(together) * 1e3:.2f} mm")
    assert np.std(together) < share * np.std(alone)
    assert np.max(np.abs(together)) < 0.001


def test_a_release_that_was_none_tells_nothing() -> None:
    heights = np.arange(-0.002, 0.002, 0.00001)
    good, bad = (Course(heights, k * np.maximum(-heights, 0.0)) for k in (5e3, 2e4))
    releases = Releases()
    releases.variance = 65.0
    first = releases.add(good, 5e3)
    alone = releases.height(first)
    releases.drop(releases.add(bad, 2e4))
    assert releases.stiffness == 5e3
    assert releases.height(first) == alone


def test_a_force_that_falls_on_the_way_down_has_no_onset() -> None:
    heights = np.arange(0.008, -0.002, -0.0001)
    assert onset(Course(heights, 500.0 * heights)) is None
