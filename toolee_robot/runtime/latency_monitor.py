"""Whether the machine itself stalls at times: the host of a virtual machine takes its cores away without a word,
and no real-time priority helps against that. What is bound to the clock tells by it the machine's faults from its own.
"""

from __future__ import annotations

import gc
import mmap
import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from types import TracebackType
from typing import Final, Self

import numpy as np

from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array

PRIORITY: Final = 60
"""Of SCHED_FIFO: over the driver's (40) and the stand-in's (1), so that what they do to each other is never put down to
the machine."""
STALL: Final = 0.005  # [s] from which on they are counted
STALL_LIMIT: Final = 0.02
"""[s] Under the least bound of the driver that a standing machine breaks: a UR10's on its data's age, 24 ms (three
readings of 125 Hz). What failed while the machine stalled for longer is tried again, and said to have been."""


class LatencyMonitor:
    """Measures stalls: a process beside what is measured, with a thread on each core that sleeps for `pause` [s] again
    and again, and sees by how much it overslept."""

    def __init__(self, pause: float = 0.002) -> None:
        self._pause = pause

    def __enter__(self) -> Self:
        """Raises DeviceError when it does not start."""
        cores = sorted(os.sched_getaffinity(0))
        fd = os.memfd_create("toolee-latency-monitor")
        try:
            os.truncate(fd, 2 * len(cores) * 8)
            self._longest, self._count = _shared(fd)
            self._longest[:] = -1.0
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(fd), str(self._pause), *map(str, cores)], pass_fds=(fd,)
            )
        finally:
            os.close(fd)
        while self._longest.min() < 0.0:
            if self._process.poll() is not None:
                raise DeviceError("the latency monitor's process died at its start")
            time.sleep(self._pause)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait()

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def begin(self) -> None:
        """Forget what was."""
        self._longest[:] = self._count[:] = 0.0

    @property
    def longest(self) -> float:
        """[s] The longest stall since `begin`, of any core."""
        return float(self._longest.max())

    @property
    def count(self) -> int:
        """Stalls since `begin` of more than STALL, of the core that had most."""
        return int(self._count.max())


def _shared(fd: int) -> Array:
    """(2, cores): the longest stall [s], and their number."""
    return np.frombuffer(mmap.mmap(fd, 0)).reshape(2, -1)


def _watch(fd: int, pause: float, cores: list[int]) -> None:
    longest, count = _shared(fd)
    gc.disable()
    with suppress(OSError):  # not permitted: nor is it to what is measured
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))

    def sleep(i: int) -> None:
        os.sched_setaffinity(0, {cores[i]})
        longest[i] = 0.0
        before = time.monotonic()
        while True:
            time.sleep(pause)
            now = time.monotonic()
            late = now - before - pause
            if late > longest[i]:
                longest[i] = late
            if late > STALL:
                count[i] += 1
            before = now

    for i in range(len(cores)):
        threading.Thread(target=sleep, args=(i,), daemon=True).start()
    with suppress(KeyboardInterrupt):
        threading.Event().wait()


if __name__ == "__main__":
    _watch(int(sys.argv[1]), float(sys.argv[2]), [int(core) for core in sys.argv[3:]])
