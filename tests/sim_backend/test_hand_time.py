"""An emulated hand's time: it never goes back, and is held back behind a slower clock while it follows one."""

from __future__ import annotations

import time

import pytest

from toolee_robot.sim_backend.hand_wire import HandTime


def test_it_stands_where_the_clock_that_it_follows_stands_and_does_not_jump_afterwards() -> None:
    hand, clock = HandTime(1.0), [5.0]
    begin = hand()
    with hand.following(lambda: clock[0], 0.04):
        time.sleep(0.1)
        assert hand() - begin == pytest.approx(0.04, abs=0.005)
        assert hand() == hand()
        clock[0] += 0.02
        time.sleep(0.05)
        assert hand() - begin == pytest.approx(0.06, abs=0.005)
        stood = hand()
    free = time.monotonic()
    time.sleep(0.02)
    assert 0.02 <= hand() - stood <= time.monotonic() - free + 0.005


def test_it_runs_at_its_pace_and_never_back() -> None:
    hand, begin = HandTime(0.5), time.monotonic()
    times = [hand()]
    while time.monotonic() - begin < 0.05:
        times.append(hand())
    assert times == sorted(times)
    assert 0.0 < times[-1] - times[0] <= 0.5 * (time.monotonic() - begin)
