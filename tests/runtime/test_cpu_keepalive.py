"""What keeps a virtual machine's cores from halting: there while it is wanted, in nobody's way, gone with its user."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from benchmarks.servo import cpu_time
from tests.runtime.processes import alive
from toolee_robot.runtime.cpu_keepalive import CpuKeepalive, is_virtual

pytestmark = pytest.mark.skipif(not is_virtual(), reason="a machine of one's own needs none of it")


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


def test_they_end_with_a_user_that_is_killed() -> None:
    program = "import time\nfrom toolee_robot.runtime.cpu_keepalive import CpuKeepalive\nwith CpuKeepalive() as a:\n"
    program += "    print(*a.pids, flush=True)\n    time.sleep(60)"
    user = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert user.stdout is not None
    pids = [int(word) for word in user.stdout.readline().split()]
    assert pids
    assert all(alive(pid) for pid in pids)
    user.send_signal(signal.SIGKILL)
    user.wait()
    deadline = time.monotonic() + 20.0
    while any(alive(pid) for pid in pids):
        assert time.monotonic() < deadline, "they outlive their user"
        time.sleep(0.05)
