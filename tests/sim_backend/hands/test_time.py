"""An emulated hand's time never goes back."""

from __future__ import annotations

import time

from toolee_robot.sim_backend.hands.kit import HandTime


def test_it_runs_at_its_pace_and_never_back() -> None:
    hand, begin = HandTime(0.5), time.monotonic()
    times = [hand()]
    while time.monotonic() - begin < 0.05:
        times.append(hand())
    assert times == sorted(times)
    assert 0.0 < times[-1] - times[0] <= 0.5 * (time.monotonic() - begin)
