"""What measures the machine's stalls: there while it is wanted, gone with its user."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

from tests.runtime.processes import alive
from toolee_robot.runtime.latency_monitor import LatencyMonitor


def test_it_measures_until_the_end() -> None:
    with LatencyMonitor() as monitor:
        monitor.begin()
        time.sleep(0.3)
        assert monitor.longest > 0.0
        assert alive(monitor.pid)
    assert not alive(monitor.pid)


@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGTERM])
def test_it_ends_with_a_user_that_is_killed(sign: signal.Signals) -> None:
    program = "import time\nfrom toolee_robot.runtime.latency_monitor import LatencyMonitor\n"
    program += "with LatencyMonitor() as a:\n    print(a.pid, flush=True)\n    time.sleep(60)"
    user = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert user.stdout is not None
    pid = int(user.stdout.readline())
    assert alive(pid)
    user.send_signal(sign)
    user.wait()
    deadline = time.monotonic() + 20.0
    while alive(pid):
        assert time.monotonic() < deadline, "it outlives its user"
        time.sleep(0.05)
