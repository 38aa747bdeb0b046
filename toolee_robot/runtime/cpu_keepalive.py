"""Keeps the cores of a virtual machine from halting while something is bound to the clock.

A core without work halts, and a busy host may take its time to give it back: on one, a machine with little to do stood
still for up to 290 ms in a half minute, and mostly for 3 to 40 ms while something ran on every core (once for 205). So
something does, at a priority that gives way to everything. A machine of one's own needs none of it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

# Linux shares a core among sessions first (sched_autogroup): a session's only process has half of it beside another's,
# whatever its own priority, and holds up by 3 ms what wakes. So its session is the least one, too.
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
    """While this context lasts, and its process, a process of the lowest priority runs on each core that this one may
    use, if the machine is a virtual one."""

    def __init__(self) -> None:
        self._processes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Self:
        if is_virtual():
            for core in sorted(os.sched_getaffinity(0)):
                program = _BUSY_LOOP.format(core=core, parent=os.getpid())
                # A session of its own: Ctrl-C is not meant for it.
                self._processes.append(subprocess.Popen([sys.executable, "-S", "-c", program], start_new_session=True))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for spinner in self._processes:
            spinner.kill()
        for spinner in self._processes:
            spinner.wait()
        self._processes.clear()

    @property
    def pids(self) -> list[int]:
        """Of the processes."""
        return [spinner.pid for spinner in self._processes]


def is_virtual() -> bool:
    """Whether a hypervisor says so to the processor's user; an x86 one does."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("flags"):
                return "hypervisor" in line.split()
    return False
