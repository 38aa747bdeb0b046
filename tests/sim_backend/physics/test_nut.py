"""The nut and the jaw that turns it: what holds for every nut, jaw and way of turning."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from tests.examples import QUICK, examples
from toolee_robot.sim_backend.physics.nut import LARGEST_TILT, Fit, Jaw, JawPlace, Nut, NutSpec

STIFFNESS = 500.0
CYCLE = 0.25 / 125  # a turn's speed [rad/s] over a CB3's rate [Hz]: what the jaw turns in one control step [rad]
PLAYS = st.floats(0.005, 0.07)
SPECS = st.builds(
    NutSpec, across_flats=st.floats(0.01273, 0.013), friction=st.floats(0.02, 0.5), run=st.floats(0.0, 2.0),
    stiffness=st.floats(0.5, 40.0),
)  # fmt: skip
JAWS = st.builds(Jaw, opening=st.floats(0.01304, 0.01324))


@examples(QUICK)
@given(SPECS, PLAYS, st.floats(0.6, 4.0))
def test_the_torque_exceeds_what_it_is_stopped_at_by_one_control_step_at_most(
    spec: NutSpec, play: float, wanted: float
) -> None:
    nut, jaw = Nut(spec), 0.0
    while -nut.follow(jaw, play, STIFFNESS) < wanted and jaw < 12.0:
        jaw += CYCLE
    assert nut.torque <= nut.largest + 1e-9
    assert nut.largest <= wanted + CYCLE * STIFFNESS
    assert jaw < 12.0


@examples(QUICK)
@given(SPECS, PLAYS, st.lists(st.floats(0.0, 0.3), min_size=1, max_size=30))
def test_a_jaw_that_only_tightens_never_turns_the_nut_back(spec: NutSpec, play: float, steps: list[float]) -> None:
    nut, jaw, angle = Nut(spec), 0.0, 0.0
    for step in steps:
        jaw += step
        torque = nut.follow(jaw, play, STIFFNESS)
        assert torque <= 0.0
        assert angle <= nut.angle <= jaw
        assert -torque <= nut.torque + 1e-9, "a nut resists with no more than what turns it"
        angle = nut.angle


@examples(QUICK)
@given(SPECS, PLAYS, st.floats(0.1, 3.0), st.floats(0.0, 1.0))
def test_turning_back_within_the_play_moves_nothing(spec: NutSpec, play: float, ahead: float, share: float) -> None:
    nut = Nut(spec)
    nut.follow(ahead, play, STIFFNESS)
    angle, torque = nut.angle, nut.torque
    for k in range(1, 11):
        nut.follow(angle + play - 0.1 * k * share * 2.0 * play, play, STIFFNESS)
        assert (nut.angle, nut.torque) == (angle, torque)


@examples(QUICK)
@given(SPECS, PLAYS, st.floats(0.2, 3.0), st.floats(0.2, 1.0))
def test_a_jaw_that_turns_far_back_loosens_the_nut(spec: NutSpec, play: float, ahead: float, back: float) -> None:
    nut = Nut(spec)
    nut.follow(ahead, play, STIFFNESS)
    before = nut.angle
    torque = nut.follow(before - play - back, play, STIFFNESS)
    assert nut.angle < before
    assert 0.0 <= torque <= nut.torque + 1e-6


@examples(QUICK)
@given(SPECS, JAWS, st.floats(-0.004, 0.004))
def test_a_jaw_in_reach_of_the_nut_has_room_for_it(spec: NutSpec, jaw: Jaw, along: float) -> None:
    assert jaw.room(spec, along) >= 0.5 * (jaw.opening - spec.across_flats) - 1e-12
    assert math.radians(0.2) < jaw.play(spec, along) <= math.pi / 6
    assert 0.0 <= jaw.cover(spec, along) <= 1.0


@examples(QUICK)
@given(SPECS, JAWS, st.floats(-0.05, 0.05), st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), st.floats(0.0, 0.5))
def test_a_jaw_that_is_tilted_or_off_slips_off_under_load(
    spec: NutSpec, jaw: Jaw, along: float, beside: float, above: float, tilt: float
) -> None:
    place = JawPlace(along, beside, above, tilt)
    held = jaw.cover(spec, along) >= 0.5 and tilt <= LARGEST_TILT
    assert jaw.slips(spec, place, 2.0) == (not held)
    assert not jaw.slips(spec, place, 0.1), "without a load it only stands there"


def test_the_nut_comes_in_through_the_mouth() -> None:
    spec, jaw = NutSpec(), Jaw()
    before, seen = Fit.APART, []
    for mm in range(20, -2, -1):
        before = jaw.fit(spec, JawPlace(1e-3 * mm, 0.0, 0.0, 0.0), before, 0.0)
        seen.append(before)
    assert list(dict.fromkeys(seen)) == [Fit.APART, Fit.ENTERING, Fit.ON]
    beside = JawPlace(0.0135, 0.007, 0.0, 0.0)
    assert jaw.fit(spec, beside, Fit.APART, 0.0) is Fit.BLOCKED, "a tip stands before the nut"
    assert jaw.fit(spec, JawPlace(0.0, 0.0, 0.008, 0.0), Fit.APART, 0.0) is Fit.APART, "it goes over the nut"
    assert jaw.fit(spec, JawPlace(0.0135, 0.0, 0.0, 0.3), Fit.APART, 0.0) is Fit.BLOCKED, "it is tilted"
