"""Processes by their number."""

from __future__ import annotations

import gc
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from benchmarks.servo import cpu_time
from toolee_robot.devices.ur.protocols import tcp
from toolee_robot.errors import NoAnswerError
from toolee_robot.runtime.clock import readable
from toolee_robot.runtime.latency_monitor import (
    CpuKeepalive,
    LatencyMonitor,
    gc_paused,
    gc_settled,
    gc_spared,
    is_virtual,
)


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and was not waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


MANY = 1100
"""More descriptors than `select.select` can watch, 1024."""


@pytest.fixture(params=[MANY, 0])
def others(request: pytest.FixtureRequest) -> Iterator[int]:
    """So many open descriptors: with MANY, the next one has a number over 1024."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MANY + 100
    if soft != resource.RLIM_INFINITY and soft < wanted:
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        except (ValueError, OSError):
            pytest.skip(f"this system allows no {wanted} open files")
    null = os.open(os.devnull, os.O_RDONLY)
    opened = [null, *(os.dup(null) for _ in range(request.param))]
    yield request.param
    for fd in opened:
        os.close(fd)
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_data_come_and_deadlines_hold_with_any_number_of_open_files(others: int) -> None:
    near, far = socket.socketpair()
    with near, far:
        assert near.fileno() > others
        far.sendall(b"abc")
        assert tcp.receive(near, time.monotonic() + 5.0) == b"abc"
        with pytest.raises(NoAnswerError, match="no answer in time"):
            tcp.receive(near, time.monotonic() + 0.02)
        far.shutdown(socket.SHUT_WR)
        with pytest.raises(NoAnswerError, match="the peer closed the connection"):
            tcp.receive(near, time.monotonic() + 5.0)
        near.close()
        with pytest.raises(NoAnswerError, match="the connection broke"):
            tcp.receive(near, time.monotonic() + 5.0)


@pytest.mark.usefixtures("others")
def test_only_what_is_ready_is_named_and_a_closed_descriptor_is_an_error() -> None:
    (quiet, quiet_end), (ready, ready_end), (ended, ended_end) = (os.pipe() for _ in range(3))
    os.write(ready_end, b"x")
    os.close(ended_end)
    assert readable([quiet, ready, ended], -1.0) == [ready, ended]
    assert readable([], 0.0) == []
    for fd in (quiet, ready, ended, quiet_end, ready_end):
        os.close(fd)
    with pytest.raises(OSError, match="Bad file descriptor"):
        readable([quiet], 0.0)


def seen_by_a_full_collection() -> int:
    """Number of objects that a full collection goes through."""
    return sum(len(gc.get_objects(generation)) for generation in range(3))


def test_a_settled_collection_leaves_out_what_was_there_and_what_came_until_it_was_told() -> None:
    before = seen_by_a_full_collection()
    with gc_settled() as settle:
        assert seen_by_a_full_collection() < before / 10
        station: list[Callable[[], int]] = [lambda: 1 for _ in range(5000)]
        assert seen_by_a_full_collection() > 5000
        settle()
        assert seen_by_a_full_collection() < 5000
    assert seen_by_a_full_collection() > before / 2 + len(station)


def test_cycles_are_still_collected_while_it_is_settled() -> None:
    class Node:
        alive = 0

        def __init__(self) -> None:
            Node.alive += 1
            self.itself = self

        def __del__(self) -> None:
            Node.alive -= 1

    with gc_settled():
        Node()
        assert Node.alive == 1
        gc.collect()
        assert Node.alive == 0


def test_a_pause_ends_as_it_began() -> None:
    with gc_paused():
        assert not gc.isenabled()
    assert gc.isenabled()


def test_what_came_while_the_collector_was_spared_is_left_out_from_then_on() -> None:
    try:
        with gc_spared():
            assert not gc.isenabled()
            module: list[Callable[[], int]] = [lambda: 1 for _ in range(5000)]
        assert gc.isenabled()
        assert seen_by_a_full_collection() < len(module)
    finally:
        gc.unfreeze()


def test_it_measures_until_the_end() -> None:
    with LatencyMonitor() as monitor:
        monitor.begin()
        time.sleep(0.3)
        assert monitor.longest > 0.0
        assert alive(monitor.pid)
    assert not alive(monitor.pid)


@pytest.mark.parametrize(
    ("name", "sign"),
    [
        ("LatencyMonitor", signal.SIGKILL),
        *(
            pytest.param(name, sign, marks=pytest.mark.nightly)
            for name, sign in (("LatencyMonitor", signal.SIGTERM), ("CpuKeepalive", signal.SIGKILL))
        ),
    ],
)
def test_it_ends_with_a_user_that_is_killed(name: str, sign: signal.Signals) -> None:
    if name == "CpuKeepalive" and not is_virtual():
        pytest.skip("a machine of one's own needs none of it")
    program = f"import time\nfrom toolee_robot.runtime.latency_monitor import {name}\nwith {name}() as a:\n"
    program += "    print(*getattr(a, 'pids', None) or [a.pid], flush=True)\n    time.sleep(60)"
    user = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert user.stdout is not None
    pids = [int(word) for word in user.stdout.readline().split()]
    assert pids
    assert all(alive(pid) for pid in pids)
    user.send_signal(sign)
    user.wait()
    deadline = time.monotonic() + 20.0
    while any(alive(pid) for pid in pids):
        assert time.monotonic() < deadline, "they outlive their user"
        time.sleep(0.05)


@pytest.mark.skipif(not is_virtual(), reason="a machine of one's own needs none of it")
def test_every_core_has_one_of_the_lowest_priority_until_the_end() -> None:
    with CpuKeepalive() as keepalive:
        deadline = time.monotonic() + 20.0
        while not all(os.sched_getscheduler(pid) == os.SCHED_IDLE for pid in keepalive.pids):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        cores = [os.sched_getaffinity(pid) for pid in keepalive.pids]
        assert sorted(core for of in cores for core in of) == sorted(os.sched_getaffinity(0))
        pids = keepalive.pids
    assert pids
    assert not any(alive(pid) for pid in pids)


@pytest.mark.nightly
@pytest.mark.skipif(not is_virtual(), reason="a machine of one's own needs none of it")
def test_they_leave_the_cores_to_whatever_else_runs() -> None:
    """Beside other sessions' work, too: each is given a share of its own."""
    busy = "import os\nos.sched_setaffinity(0, {%d})\nwhile True:\n    pass"
    with CpuKeepalive() as keepalive:
        cores = sorted(os.sched_getaffinity(0))
        work = [subprocess.Popen([sys.executable, "-c", busy % core], start_new_session=True) for core in cores]
        try:
            time.sleep(1.0 + 0.2 * len(cores))  # all have started, and given way: one at a time, without root
            began, before = time.monotonic(), [cpu_time(pid) for pid in keepalive.pids]
            time.sleep(2.0)
            taken = [cpu_time(pid) - then for pid, then in zip(keepalive.pids, before, strict=True)]
            assert max(taken) < 0.1 * (time.monotonic() - began)
        finally:
            for process in work:
                process.kill()
                process.wait()
