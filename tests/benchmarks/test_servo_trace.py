"""What `benchmarks.servo` makes of what was sent and what the joints did, on streams whose faults are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.servo import drift, wave
from benchmarks.servo_trace import TraceFigures, compare
from toolee_robot.frames import Array
from toolee_robot.hal import MotionOutcome, MotionReport
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.sim_backend.ur_controller.robot.servoj import ServoJ

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


def test_a_tick_that_was_late_itself_explains_what_follows_from_it_however_late_that_ends() -> None:
    taken = np.arange(N)
    taken[1000:1400] -= 1
    ticks = 100.0 + LAG + PERIOD * np.arange(N)
    ticks[999] += 0.4 * PERIOD
    figures = _figures(*_sent(), taken=taken, stamps=ticks)
    assert (figures.held, figures.skipped, figures.unreported) == (1, 1, 0)
    assert figures.late_ticks == 2


@pytest.mark.parametrize(("late", "early", "close"), [(0.47, 0.0, 1), (0.45, 0.1, 1), (0.3, 0.2, 1), (0.2, 0.0, 0)])
def test_a_command_and_its_tick_that_just_miss_each_other_are_told_from_joints_that_stray(
    late: float, early: float, close: int
) -> None:
    """Each by less than what either is called late for; the joints are the stand-in's, which go on meanwhile."""
    sent, commands = _sent()
    ticks = sent + LAG
    sent[1000] += late * PERIOD
    ticks[1000] -= early * PERIOD
    there = np.searchsorted(sent + 0.06 * PERIOD, ticks) - 1
    figures = _figures(sent, commands, there, ticks, _servoed(commands, there) - commands[there])
    assert (figures.unreported, figures.late_ticks, figures.close_ticks) == (0, 0, close)
    assert figures.lag_error < 1e-12
    assert figures.followed > 0.98


def _servoed(commands: Array, there: Any) -> Array:
    """(N, 6) [rad]: where the stand-in's joints are after each tick that goes by that command."""
    q, qd, rows = commands[there[0]], (commands[1] - commands[0]) / PERIOD, []
    motion = ServoJ(MODELS["UR10e"], q, PERIOD)
    for k in there:
        before, motion = motion, ServoJ(MODELS["UR10e"], commands[k], PERIOD)
        motion.follow(before)
        way = motion.step(q, qd, PERIOD, PERIOD)
        q, qd = q + way, way / PERIOD
        rows.append(q)
    return np.array(rows)


@pytest.mark.parametrize(("off", "unreported"), [(1e-4, 0), (0.0, 1)])
def test_joints_that_catch_up_are_between_commands_and_tell_of_none_that_was_missed(
    off: float, unreported: int
) -> None:
    sent, commands = _sent()
    ticks = sent[0] + LAG + PERIOD * np.arange(N)
    ticks[999] += 0.4 * PERIOD  # what the joints catch up after
    taken = np.arange(N)
    taken[1014:1018] -= 1
    joints_off = np.zeros((N, 6))
    joints_off[1001:1020] = off
    figures = _figures(sent, commands, taken, ticks, joints_off)
    assert figures.held == 1
    assert figures.unreported == unreported


@given(
    late=st.lists(st.tuples(st.integers(0, 4999), st.floats(0.0, 0.9)), max_size=300),
    missed=st.lists(st.integers(1, 4999), max_size=100),
)
def test_late_and_missed_cycles_are_no_drift(late: list[tuple[int, float]], missed: list[int]) -> None:
    slots: Any = np.arange(5000.0)
    for at in missed:
        slots[at:] += 1.0
    for at, by in late:
        slots[at] = np.floor(slots[at]) + by
    assert abs(drift(50.0 + 0.008 * slots, 0.008)) < 0.0008


@given(st.floats(-3e-4, 3e-4))
def test_a_schedule_that_wanders_is_drift(share: float) -> None:
    stamps: Any = 50.0 + 0.008 * (1.0 + share) * np.arange(20000)
    assert drift(stamps, 0.008) == pytest.approx(share * (stamps[-1] - stamps[0] - 1.5), abs=3e-4)
