"""Keeps the cores of a virtual machine from halting during time-critical work.

An idle virtual core halts, and a busy host may reschedule it late: stalls of up to 290 ms were measured within half a
minute on an idle machine, mostly 3 to 40 ms with a process on every core. A physical machine does not need this.
"""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Self

# Linux shares a core among sessions first (sched_autogroup): whatever its own priority, the only process of a session
# gets half of the core and delays what wakes up by 3 ms. Hence the session has the lowest priority, too.
_BUSY_LOOP = """
import os, time
os.sched_setaffinity(0, {{{core}}})
os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
while os.getppid() == {parent}:
    try:
        with open("/proc/self/autogroup", "w") as share:
            share.write("19")
    except BlockingIOError:  # nobody but root may do it twice in a tenth of a second, on the whole machine
        time.sleep(0.11)
    except OSError:  # a kernel without
        break
    else:
        break
while os.getppid() == {parent}:
    for _ in range(1_000_000):
        pass
"""


class CpuKeepalive:
    """Context in which a process of the lowest priority runs on every usable core of a virtual machine.

    On a physical machine it does nothing. The processes end with the one that started them.
    """

    def __init__(self) -> None:
        self._processes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Self:
        if is_virtual():
            for core in sorted(os.sched_getaffinity(0)):
                program = _BUSY_LOOP.format(core=core, parent=os.getpid())
                # A session of its own, so that it does not receive Ctrl-C.
                self._processes.append(subprocess.Popen([sys.executable, "-S", "-c", program], start_new_session=True))
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes:
            process.kill()
        for process in self._processes:
            process.wait()
        self._processes.clear()

    @property
    def pids(self) -> list[int]:
        """Process ids of the processes."""
        return [process.pid for process in self._processes]


def is_virtual() -> bool:
    """Whether this is a virtual machine, as its processor's flags tell (x86)."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("flags"):
                return "hypervisor" in line.split()
    return False
