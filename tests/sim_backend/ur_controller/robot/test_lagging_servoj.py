"""`servoj` with the lag of a real controller: how late, how stable, and what the speed slider does to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.controller import Controller, ControllerOptions
from toolee_robot.sim_backend.ur_controller.process import resting_joints
from toolee_robot.sim_backend.ur_controller.profile import (
    CB3,
    E_SERIES,
    Profile,
    ProfileName,
    ServoLag,
    StopDecelerations,
)
from toolee_robot.sim_backend.ur_controller.profile import profile as machine_profile
from toolee_robot.sim_backend.ur_controller.robot.plant import UR10, UR10E, ControllerModel
from toolee_robot.sim_backend.ur_controller.robot.servoj import LaggingServoJ

BOTH = [(UR10, CB3), (UR10E, E_SERIES)]
both = pytest.mark.parametrize(("model", "profile"), BOTH, ids=["CB3", "e-Series"])
either = st.sampled_from(BOTH)
gains = st.floats(100.0, 2000.0)
lookaheads = st.floats(0.03, 0.2)


def lag_of(profile: Profile) -> ServoLag:
    assert profile.servo is not None
    return profile.servo


def stream(
    model: ControllerModel, profile: Profile, goals: Array, gain: float, lookahead: float, rate: float = 1.0
) -> Array:
    """Set-points, one row a tick, of a call of servoj in every tick; `rate` is the slider's."""
    q, qd, before, found = goals[0], np.zeros(6), None, []
    for goal in goals:
        motion = LaggingServoJ(model, lag_of(profile), goal, lookahead, gain)
        if before is not None:
            motion.follow(before)
        way = motion.step(q, qd, rate * model.period, model.period)
        q, qd, before = q + way, way / model.period, motion
        found.append(q)
    return np.array(found)


def ramp(model: ControllerModel, seconds: float, speed: float = 0.3) -> Array:
    """Goals that start gently and end at constant speed, (ticks, 6) [rad]."""
    t = np.arange(round(seconds * model.rate)) * model.period
    way = speed * np.where(t < 0.5, t**2, t - 0.25)
    return np.outer(way, [1.0, -1.0, 0.5, 1.0, 0.3, -0.7])


def measured_lag(model: ControllerModel, profile: Profile, gain: float, lookahead: float, rate: float = 1.0) -> float:
    """Lag at the end of a ramp [s]."""
    goals = ramp(model, 3.5)
    q = stream(model, profile, goals, gain, lookahead, rate)
    return float((goals[-1, 0] - q[-1, 0]) / 0.3)


@pytest.mark.parametrize(("model", "profile", "lag"), [(UR10, CB3, 0.054), (UR10E, E_SERIES, 0.034)])
def test_the_lag_is_the_profiles_at_the_gain_where_it_was_measured(
    model: ControllerModel, profile: Profile, lag: float
) -> None:
    assert measured_lag(model, profile, 1200.0, 0.03) == pytest.approx(lag, abs=1e-3)


@pytest.mark.parametrize("lag", [0.03, 0.05, 0.071, 0.12])
@both
def test_the_lag_is_a_labs_own_where_it_is_given(model: ControllerModel, profile: Profile, lag: float) -> None:
    changed = replace(profile, servo=lag_of(profile).with_lag(lag, model.period))
    assert measured_lag(model, changed, 1200.0, 0.03) == pytest.approx(lag, abs=1e-3)


@pytest.mark.parametrize("name", ["ideal", "harsh"])
@pytest.mark.parametrize("model", [UR10, UR10E], ids=["CB3", "e-Series"])
def test_a_controller_takes_a_labs_own_lag_and_stops(model: ControllerModel, name: ProfileName) -> None:
    stops = StopDecelerations(protective=8.0, safeguard=7.0, emergency=9.0)
    machine = Controller(
        ControllerOptions(model.name, profile=name, lag=0.071, stops=stops), resting_joints
    ).robot.machine
    assert machine.servo_lag is not None
    assert machine.servo_lag.lag(1200.0, 0.03, model.period) == pytest.approx(0.071, abs=1e-9)
    assert machine.stops == stops
    plain = Controller(ControllerOptions(model.name, profile=name), resting_joints).robot.machine
    assert plain.servo_lag == machine_profile(name, model.e_series).servo


@given(kind=either, gain=gains, lookahead=lookaheads)
@examples(8)
def test_the_lag_is_what_the_profile_computes(
    kind: tuple[ControllerModel, Profile], gain: float, lookahead: float
) -> None:
    model, profile = kind
    expected = lag_of(profile).lag(gain, lookahead, model.period)
    assert measured_lag(model, profile, gain, lookahead) == pytest.approx(expected, abs=2e-3)


@given(kind=either, gain=gains, lookahead=lookaheads, more=st.floats(1.05, 4.0))
@examples(5)
def test_the_lag_grows_with_the_lookahead_and_shrinks_with_the_gain(
    kind: tuple[ControllerModel, Profile], gain: float, lookahead: float, more: float
) -> None:
    model, profile = kind
    here = measured_lag(model, profile, gain, lookahead)
    longer, stiffer = min(lookahead * more, 0.2), min(gain * more, 2000.0)
    assert measured_lag(model, profile, gain, longer) >= here - 1e-6
    assert measured_lag(model, profile, stiffer, lookahead) <= here + 1e-6


@given(
    kind=either,
    gain=gains,
    lookahead=lookaheads,
    goals=st.lists(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6), min_size=1, max_size=3),
    rate=st.floats(0.2, 1.0),
)
@examples(6)
def test_any_goals_are_reached_within_the_limits(
    kind: tuple[ControllerModel, Profile], gain: float, lookahead: float, goals: list[list[float]], rate: float
) -> None:
    """Stable over the whole range: jumps of the goal are followed within velocity and acceleration, and end there."""
    model, profile = kind
    ticks = round(0.2 * model.rate)
    path = [np.zeros(6)] + [np.array(goal) for goal in goals for _ in range(ticks)]
    # The farthest way at the scaled speed, from where the jumps before it have led, and eight lags.
    travel = 1.5 / (rate * min(model.velocity)) + 0.4
    settled = travel + 8.0 * lag_of(profile).lag(gain, lookahead, model.period) / rate
    path += [np.array(goals[-1])] * round(settled * model.rate)
    q = stream(model, profile, np.array(path), gain, lookahead, rate)
    np.testing.assert_allclose(q[-1], goals[-1], atol=1e-3)
    speeds = np.diff(q, axis=0) * model.rate
    assert np.all(np.abs(speeds) <= np.array(model.velocity) * (1 + 1e-6))
    change = np.abs(np.diff(speeds, axis=0)).max() * model.rate
    assert change <= 2.1 * model.acceleration, "halves of two ticks' changes may add up, no more"
    assert np.abs(q).max() < 4.0


@both
def test_a_step_overshoots_where_the_gain_is_high_and_the_lookahead_short(
    model: ControllerModel, profile: Profile
) -> None:
    goals = np.vstack([np.zeros((1, 6)), np.full((round(3.0 * model.rate), 6), 0.02)])

    def overshoot(gain: float, lookahead: float) -> float:
        return float(stream(model, profile, goals, gain, lookahead).max() / 0.02 - 1.0)

    assert 0.03 < overshoot(2000.0, 0.03) < 0.25
    assert overshoot(2000.0, 0.2) < 1e-3
    assert overshoot(300.0, 0.1) < 1e-3


@both
def test_at_half_the_slider_the_lag_is_longer_and_at_zero_the_arm_stands(
    model: ControllerModel, profile: Profile
) -> None:
    """The set-points of a stream do not wait for the slider: the arm falls behind them."""
    full = measured_lag(model, profile, 300.0, 0.1)
    assert measured_lag(model, profile, 300.0, 0.1, rate=0.5) > 1.7 * full
    goals = ramp(model, 1.0)
    np.testing.assert_array_equal(stream(model, profile, goals, 300.0, 0.1, rate=0.0)[-1], goals[0])
