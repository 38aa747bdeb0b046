"""Late, repeated and impossible readings, two clocks that nobody has set by each other, and commands that are lost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from toolee_robot.devices.hands.shadow.acknowledgement import Acknowledgement
from toolee_robot.devices.hands.shadow.freshness import Freshness, HandClock
from toolee_robot.devices.hands.shadow.messages import JointStates
from toolee_robot.devices.hands.wire.counts import LineCounts


def at(stamp: float, angle: float = 0.0) -> JointStates:
    return JointStates(stamp, np.full(24, angle), np.zeros(24), np.zeros(24))


def entered(counts: LineCounts) -> Freshness:
    fresh = Freshness(counts)
    assert not fresh.admit(at(100.0)), "one alone may be damaged"
    assert fresh.admit(at(100.008))
    return fresh


def test_what_is_late_or_repeated_is_refused() -> None:
    counts = LineCounts()
    fresh = entered(counts)
    assert not fresh.admit(at(100.008))
    assert not fresh.admit(at(100.004))
    assert not fresh.admit(at(99.0))
    assert not fresh.admit(at(99.008)), "two late ones agree with each other, and are late"
    assert counts.late == 4
    assert fresh.admit(at(100.016))
    assert counts.corrupt == 0


def test_a_joint_that_jumps_is_believed_when_the_next_reading_agrees() -> None:
    counts = LineCounts()
    fresh = entered(counts)
    assert not fresh.admit(at(100.016, 0.3))
    assert fresh.admit(at(100.024, 0.0)), "it was damaged"
    assert not fresh.admit(at(100.032, 0.3))
    assert fresh.admit(at(100.040, 0.31)), "it was knocked aside"
    assert counts.corrupt == 2


def test_a_stamp_from_the_future_does_not_shut_out_the_readings_after_it() -> None:
    fresh = entered(LineCounts())
    assert not fresh.admit(at(9_000_000.0))
    assert fresh.admit(at(100.016))


def test_after_a_pause_two_readings_are_needed() -> None:
    fresh = entered(LineCounts())
    assert not fresh.admit(at(110.0, 0.5))
    assert fresh.admit(at(110.008, 0.5))


@given(st.floats(-1e9, 1e9), st.lists(st.floats(0.0, 0.5), min_size=1, max_size=30))
@example(0.0, [0.5, 0.125] * 5)  # the clocks drift apart once in a time, however often it seems to pass
def test_a_reading_is_as_old_as_it_came_later_than_the_fastest(offset: float, delays: list[float]) -> None:
    clock = HandClock()
    clock.station_time(offset, 10.0)  # the fastest
    for i, delay in enumerate(delays, 1):
        taken = 10.0 + 0.008 * i
        told = clock.station_time(offset + 0.008 * i, taken + delay)
        assert told == pytest.approx(taken, abs=1e-3)
        assert told <= taken + delay


def test_a_clock_that_runs_slow_does_not_let_the_hand_seem_silent() -> None:
    clock = HandClock()
    for second in range(3600):
        age = second - clock.station_time(1000.0 + second * (1.0 - 1e-4), float(second))
        assert age < 1e-3


def test_a_clock_that_is_put_forward_by_a_drift_is_followed() -> None:
    clock = HandClock()
    for second in range(3600):
        told = clock.station_time(1000.0 + second * (1.0 + 1e-4), float(second))
        assert told <= second
        assert second - told < 1e-3


def test_a_command_counts_when_the_state_shows_it() -> None:
    acknowledged = Acknowledgement()
    acknowledged.shown(0.5, np.zeros(2))
    assert acknowledged.since is None, "nothing was commanded"
    acknowledged.sent(1.0, np.full(2, 0.0))
    acknowledged.sent(1.01, np.full(2, 0.1))
    acknowledged.sent(1.02, np.full(2, 0.2))
    assert acknowledged.since == 1.0
    acknowledged.shown(1.03, np.full(2, 0.101))
    assert acknowledged.since == 1.02
    acknowledged.shown(1.04, np.full(2, 0.15))
    assert acknowledged.since == 1.02, "on its way"
    acknowledged.shown(1.06, np.full(2, 0.2))
    assert acknowledged.since is None
    acknowledged.shown(1.08, np.array([0.2, 0.3]))
    assert acknowledged.since == 1.08, "somebody else commands it"
    acknowledged.shown(1.10, np.full(2, 0.2))
    assert acknowledged.since is None
