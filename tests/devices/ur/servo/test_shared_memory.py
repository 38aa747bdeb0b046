"""What the two processes share: the path on the controller's grid, and a state that is never half written."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from tests.examples import examples
from toolee_robot.devices.ur.servo.clock import AFTER_PACKET, FOLLOW, SEEK, Schedule
from toolee_robot.devices.ur.servo.shared_memory import ServoMemory, StateColumn, Word, presample
from toolee_robot.errors import DeviceError, LimitError
from toolee_robot.frames import Array
from toolee_robot.runtime.clock import HostClock, readable
from toolee_robot.types import Trajectory


@st.composite
def trajectories(draw: st.DrawFn) -> Trajectory:
    n = draw(st.integers(2, 12))
    steps = draw(st.lists(st.floats(1e-3, 0.05), min_size=n - 1, max_size=n - 1))
    times = np.concatenate([[0.0], np.cumsum(steps)])
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    q, qd, qdd = rng.normal(size=(3, n, 6))
    return Trajectory(times, q, qd, qdd)


@given(trajectories(), st.sampled_from([125.0, 500.0]))
def test_presampling_is_sampling(trajectory: Trajectory, rate: float) -> None:
    grid = presample(trajectory, rate)
    for k, q in enumerate(grid, start=1):
        np.testing.assert_allclose(q, trajectory.sample(k / rate)[0], atol=1e-12)
    np.testing.assert_allclose(grid[-1], trajectory.q[-1], atol=1e-12)
    assert (len(grid) - 1) / rate < trajectory.duration


@given(trajectories())
def test_the_path_arrives_as_it_was(trajectory: Trajectory) -> None:
    memory = ServoMemory.create(longest=1.0)
    _, knots = memory.write_path(trajectory, 125.0)
    got = memory.path(knots)
    for name in ("times", "q", "qd", "qdd"):
        np.testing.assert_array_equal(getattr(got, name), getattr(trajectory, name))
    assert got.braking is None
    braking = np.linspace([3.0, 5.0], [40.0, 60.0], len(trajectory.times))
    memory.write_path(replace(trajectory, braking=braking), 125.0)
    np.testing.assert_array_equal(memory.path(knots).braking, braking)
    memory.close()


def test_a_motion_that_is_too_long_is_refused() -> None:
    memory = ServoMemory.create(longest=1.0)
    still = np.zeros((2, 6))
    with raises(LimitError, code="limit.trajectory_length"):
        memory.write_path(Trajectory(np.array([0.0, 1.5]), still, still, still), 500.0)
    memory.close()


def test_a_state_is_read_whole_while_it_is_written() -> None:
    memory = ServoMemory.create(longest=0.1)
    ended = threading.Event()

    def write() -> None:
        value = 0.0
        while not ended.is_set():
            value += 1.0
            memory.write_state(np.full(StateColumn.COUNT, value))

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for _ in range(2000):
            assert np.ptp(memory.read_state()) == 0.0
    finally:
        ended.set()
        writer.join()


def test_a_writer_that_died_in_mid_write_is_an_error_not_a_hang() -> None:
    memory = ServoMemory.create(longest=0.1)
    memory.words[Word.STATE_SEQUENCE] += 1
    with raises(DeviceError, code="device.torn_state"):
        memory.read_state()


_TWICE = """
import gc, threading
from toolee_robot.devices.ur.servo.shared_memory import ServoMemory
for _ in range(3):
    memory = ServoMemory.create(longest=1.0)
    task = threading.Thread(target=memory.owner.hold)
    task.start()
    task.join()
    while memory.owner.owner_alive:
        pass
    memory.close()
    del memory, task
    gc.collect()
print("alive")
"""


def test_a_thread_that_has_seen_an_owner_die_outlives_the_memory() -> None:
    """The mutex that it took over must not stay in its list of robust mutexes: the next one would crash the process."""
    seen = subprocess.run([sys.executable, "-c", _TWICE], capture_output=True, text=True, check=False)
    assert (seen.returncode, seen.stdout) == (0, "alive\n"), seen.stderr


def test_the_end_of_a_thread_cuts_the_life_line_that_it_holds() -> None:
    memory = ServoMemory.create(longest=0.1)
    held, ended = threading.Event(), threading.Event()

    def live() -> None:
        memory.owner.hold()
        held.set()
        ended.wait()

    task = threading.Thread(target=live)
    task.start()
    held.wait()
    assert memory.owner.owner_alive
    ended.set()
    task.join()
    wait_until_cut(memory)
    assert not memory.owner.owner_alive, "it stays"


_TASK = """
import os, sys, time
from toolee_robot.devices.ur.servo.shared_memory import ServoMemory
memory = ServoMemory(int(sys.argv[1]), 0.1)
memory.owner.hold()
if os.fork():
    print("lives", flush=True)
time.sleep(60.0)
"""


def test_a_killed_task_cuts_it_though_a_child_of_it_lives_on() -> None:
    """Such a child holds the pipe's end open, by which alone the task would go on living."""
    memory = ServoMemory.create(longest=0.1)
    task = subprocess.Popen(
        [sys.executable, "-c", _TASK, str(memory.fd)],
        pass_fds=(memory.fd,),
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        assert task.stdout is not None
        assert task.stdout.readline() == b"lives\n"
        assert memory.owner.owner_alive
        task.kill()
        wait_until_cut(memory)
        assert not readable([task.stdout.fileno()], 0.0), "the child holds it open"
    finally:
        os.killpg(task.pid, signal.SIGKILL)
        task.wait()
        memory.close()


def wait_until_cut(memory: ServoMemory) -> None:
    deadline = time.monotonic() + 10.0
    while memory.owner.owner_alive:
        assert time.monotonic() < deadline
        time.sleep(1e-3)


def test_the_schedule_is_counted_from_its_start_and_skips_what_it_missed() -> None:
    period, clock = 0.01, _Clock()
    start = clock.now() + period
    schedule = Schedule(start, period, clock)
    for k in range(3):
        assert schedule.deadline == pytest.approx(start + k * period, abs=1e-9)
        schedule.wait()
    clock.sleep(5.5 * period)
    _, missed = schedule.wait()
    assert missed >= 4
    slot = (schedule.deadline - start) / period
    assert slot == pytest.approx(round(slot), abs=1e-6)
    assert round(slot) == 3 + missed + 1
    assert schedule.deadline > start + 7.5 * period


@dataclass(frozen=True)
class _Clock(HostClock):
    """It stands still but for those who wait for it."""

    time: list[float] = field(default_factory=lambda: [100.0])

    def now(self) -> float:
        self.time[0] += 1e-6
        return self.time[0]

    def sleep(self, duration: float) -> None:
        self.time[0] += max(duration, 0.0)


@given(
    phase=st.floats(0.0, 1.0),
    crystal=st.floats(-5e-5, 5e-5),
    late=st.lists(st.tuples(st.integers(300, 3900), st.floats(0.0, 0.9)), max_size=400),
)
@examples(30)
def test_slots_keep_their_place_after_the_controllers_packets(
    phase: float, crystal: float, late: list[tuple[int, float]]
) -> None:
    """They find it at rest and keep it in motion, though clocks differ and one packet in ten comes late."""
    period, clock = 0.002, _Clock()
    start = clock.now()
    sent: Any = start + period * (phase + (1.0 + crystal) * np.arange(4200))
    arrivals = sent.copy()
    for i, by in late:
        arrivals[i] = sent[i] + by * period

    schedule = Schedule(start, period, clock)

    def cycle(by: float) -> int:
        _, missed = schedule.wait()
        come = arrivals[arrivals <= clock.time[0]]
        if len(come):
            schedule.follow(float(come.max()), by)
        return missed

    for _ in range(200):
        cycle(SEEK)
    assert _place(clock, sent, period) == pytest.approx(AFTER_PACKET, abs=0.03)
    for _ in range(3800):
        assert cycle(FOLLOW) == 0
    assert _place(clock, sent, period) == pytest.approx(AFTER_PACKET, abs=0.06)


def _place(clock: _Clock, sent: Array, period: float) -> float:
    """Of the slot that has just begun, in its cycle."""
    return float((clock.time[0] - sent[np.searchsorted(sent, clock.time[0]) - 1]) / period)


def test_a_schedule_that_resumes_misses_nothing() -> None:
    period, clock = 0.002, _Clock()
    start = clock.now()
    schedule = Schedule(start, period, clock)
    clock.sleep(5.5 * period)
    schedule.resume()
    assert clock.time[0] < schedule.deadline <= clock.time[0] + period
    assert (schedule.deadline - start) / period == pytest.approx(round((schedule.deadline - start) / period), abs=1e-6)
    assert schedule.wait()[1] == 0
