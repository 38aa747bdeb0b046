"""What `benchmarks.servo` makes of what was sent and what the joints did, on streams whose faults are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.servo import wave
from benchmarks.servo_trace import TraceFigures, compare
from toolee_robot.frames import Array
from toolee_robot.hal import MotionOutcome, MotionReport

RATE, N = 500.0, 3000
PERIOD = 1.0 / RATE
LAG = 0.5 * PERIOD


def _sent() -> tuple[Any, Array]:
    """stamps and commands: one a cycle, never two alike."""
    return 100.0 + PERIOD * np.arange(N), wave(np.zeros(6), 2.0 * N * PERIOD).q[1 : N + 1]


def _figures(sent: Any, commands: Array, taken: Any, stamps: Any = None, off: Any = 0.0) -> TraceFigures:
    """taken: by each tick, which command; off [rad]: by how much the joints are not there yet."""
    zeros = np.zeros((len(sent), 6))
    report = MotionReport(
        stamps=sent,
        q_commanded=commands,
        q_measured=zeros,
        wrenches=zeros,
        outcome=MotionOutcome.COMPLETED,
    )
    ticks = sent[0] + LAG + PERIOD * np.arange(len(taken))
    return compare(report, ticks if stamps is None else stamps, commands[taken] + off, RATE)


def test_a_stream_in_order_is_followed_exactly() -> None:
    figures = _figures(*_sent(), taken=np.arange(N))
    assert (figures.held, figures.skipped, figures.unreported, figures.late_ticks) == (0, 0, 0, 0)
    assert figures.lag == pytest.approx(LAG)
    assert figures.lag_error < 1e-12
    assert figures.followed == 1.0


@pytest.mark.parametrize("until", [1001, 1030, 1400])
def test_a_command_that_is_lost_or_late_on_its_way_is_one_that_nobody_reported(until: int) -> None:
    taken = np.arange(N)
    taken[1000:until] -= 1  # nothing new in tick 1000; in tick `until` two
    figures = _figures(*_sent(), taken=taken)
    assert (figures.held, figures.skipped, figures.unreported) == (1, 1, 1)
    assert figures.lag_error < 1e-12
    assert figures.followed < 1.0
