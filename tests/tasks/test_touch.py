"""Guarded touches with the force of a CB3: noisy, offset, drifting; where they end, and when they are refused."""

from __future__ import annotations

import numpy as np
import pytest

from tests.control.motion.cb3_noise import RATE
from tests.errors import raises
from tests.examples import seldom
from tests.rigs.job_rig import CONFIG, Bench
from tests.tasks.noisy_arm import Rig
from toolee_robot.control.motion.touch_force import MAX_PHANTOMS
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import ZERO_TIME
from toolee_robot.sim_backend.devices.flange_sensor import ReadingErrors
from toolee_robot.tasks.hammering.touch import Contact, SidewaysContactError
from toolee_robot.types import ArmModel, Payload


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


@pytest.mark.nightly
@pytest.mark.sim(seconds=10)
def test_touches_with_a_cb3s_force_end_on_the_nail(bench: Bench) -> None:
    assert np.all(np.abs(touches(bench, range(1, 2), each=3)) < 1e-3)


@pytest.mark.nightly
@pytest.mark.sim(seconds=900)
def test_a_hundred_touches_of_a_hundred_end_within_a_millimetre(bench: Bench) -> None:
    errors = touches(bench, range(100, 120), each=5)
    assert np.sum(np.abs(errors) < 1e-3) == len(errors) == 100, errors


@pytest.mark.nightly
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


@pytest.mark.nightly
@pytest.mark.sim(seconds=10)
def test_what_feigns_a_contact_with_more_than_a_touch_may_press_ends_it(bench: Bench) -> None:
    rig = Rig(bench, seed=0, scale=0.0)
    bench.arm._sensor._errors = Dragging(14.0)
    with raises(DeviceError, code="device.force_noise") as ended:
        rig.error(0.010)
    assert f"above 8 N {MAX_PHANTOMS} times, at last 12 N, without contact on the way to the nail" in str(ended.value)
    assert rig.log.motions.count("touch the nail") == MAX_PHANTOMS


class Beside(ReadingErrors):
    """Errors of a wrench that feels a horizontal force [N] once the joints are 3 mrad from where they were."""

    def __init__(self, force: float) -> None:
        super().__init__(ArmModel.UR10, 0.0, 0, 1.0 / RATE)
        self._error = np.array([0.8 * force, 0.6 * force, 0.0, 0.0, 0.0, 0.0])
        self._begin: Array | None = None

    def step(self, q_target: Array, q: Array, qd: Array, payload: Payload) -> Array:  # noqa: ARG002
        if self._begin is None:
            self._begin = q.copy()
        return self._error if np.abs(q - self._begin).max() > 0.003 else np.zeros(6)


@pytest.mark.nightly
@pytest.mark.sim(seconds=10)
def test_what_presses_on_the_tools_side_is_no_contact_of_the_face_and_no_phantom(bench: Bench) -> None:
    rig = Rig(bench, seed=0, scale=0.0)
    rig.go_over(0.010)
    assert rig.touch.prepare()
    bench.arm._sensor._errors = Beside(10.0)
    with pytest.raises(SidewaysContactError) as ended:
        rig.touch.lower("nail", 0.020, rig.held)
    assert ended.value.force == pytest.approx(10.0, abs=1.0)
    assert rig.log.motions.count("touch the nail") == 1, "it presses no harder"


def leaning(bench: Bench) -> tuple[Rig, float]:
    """A face that rests on the nail, and the force with which it does [N]."""
    rig = Rig(bench, 3, scale=0.0)
    rig.go_over(0.006)
    assert rig.touch.prepare()
    assert rig.touch.lower("nail", 0.016, rig.held) is not None
    pressing = bench.arm.state().wrench[2]
    assert pressing > CONFIG.strike.touch_force
    return rig, pressing


def test_a_face_that_leans_against_something_is_not_zeroed(bench: Bench) -> None:
    """Zeroed while touching, the force of the nail would be gone, and the next touch would press twice as hard."""
    rig, pressing = leaning(bench)
    assert not rig.touch.prepare()
    assert bench.arm.state().wrench[2] == pytest.approx(pressing, abs=1.0)


@pytest.mark.nightly
def test_a_zero_that_was_taken_while_the_face_leant_is_told_before_the_next_touch(bench: Bench) -> None:
    """The offset is unknown before the first zero; but free again, the face misses the force that it leant with."""
    rig, pressing = leaning(bench)
    rig.motions.zero_wrench()
    rig.motions.straight("up", (0.0, 0.0, 1.0), 0.010, rig.held)
    assert not rig.touch.prepare()
    assert bench.arm.state().wrench[2] == pytest.approx(-pressing, abs=1.5)


@pytest.mark.sim(seconds=10)
@pytest.mark.parametrize(("scale", "kept"), seldom((1.0, False), (0.0, True)))
def test_a_zero_that_still_holds_is_kept_on_a_quiet_arm_only(bench: Bench, scale: float, kept: bool) -> None:
    rig = Rig(bench, 4, scale=scale)
    rig.go_over(0.010)
    assert rig.touch.prepare()
    begin = bench.sim.world.time
    assert rig.touch.prepare()
    assert (bench.sim.world.time - begin < ZERO_TIME) == kept


@pytest.mark.nightly
@pytest.mark.sim(seconds=10)
def test_a_zero_from_which_the_force_has_drifted_is_taken_anew(bench: Bench) -> None:
    rig = Rig(bench, 5, scale=0.0)
    rig.go_over(0.010)
    assert rig.touch.prepare()
    bench.arm._sensor.offset[:3] += [0.0, 0.0, 3.0]
    assert rig.touch.prepare()
    assert np.linalg.norm(rig.motions.forces(0.1).mean(axis=0)) < 0.5


@pytest.mark.nightly
@pytest.mark.sim(seconds=10)
def test_a_thing_whose_height_a_release_leaves_unsure_is_touched_again_and_harder(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("toolee_robot.tasks.hammering.touch.UNSURE", 0.0)
    rig = Rig(bench, seed=5)
    rig.go_over(0.010)
    assert rig.touch.prepare()
    deviations, surer = [], Contact.surer

    def compare(a: Contact, b: Contact) -> Contact:
        deviations.extend([a.deviation, b.deviation])
        return surer(a, b)

    monkeypatch.setattr(Contact, "surer", compare)
    contact = rig.touch.lower("nail", 0.020, rig.held)
    assert contact is not None
    assert rig.log.motions.count("touch the nail") == 3
    assert contact.deviation == np.min(deviations)
    assert contact.felt == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001)
