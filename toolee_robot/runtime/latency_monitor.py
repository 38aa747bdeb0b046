"""Ways that keep this process on time: no pauses for garbage, no core asleep, and what delayed it all the same."""

from __future__ import annotations

import gc
import mmap
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, Self

import numpy as np

from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array


@contextmanager
def gc_paused() -> Iterator[None]:
    """Context in which the garbage collector does not run.

    A collection stops all threads for up to 0.2 s, including that of the arm's heartbeat. The function is not part of
    `hardware`, which may not import `gc`, since `gc` gives access to every object, including the simulation's ground
    truth.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@contextmanager
def gc_spared() -> Iterator[None]:
    """Context of imports, through whose objects the garbage collector does not go.

    Modules stay until the process ends. The collector would go through all of them a dozen times while those of torch
    and its like are imported, for a second or more, and find nothing.
    """
    with gc_paused():
        yield
    gc.freeze()


@contextmanager
def gc_settled() -> Iterator[Callable[[], None]]:
    """Context in which a collection goes through what is new only, and is short.

    With the networks and a station loaded a full one takes some 0.2 s, in which no thread runs: nearly the
    time after which a driver takes its device for silent. Nothing that was there at the beginning is freed before the
    end.

    Returns:
        The context. Its value adds what has come since: call it when a station has been opened.
    """
    gc.collect()
    gc.freeze()
    try:
        yield gc.freeze
    finally:
        gc.unfreeze()


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


PRIORITY: Final = 60
"""SCHED_FIFO priority, above the driver's (40) and the stand-in's (1), so that their mutual delays do not count as
stalls of the machine."""
STALL: Final = 0.005
"""Least duration of a counted stall [s]."""
ORPHAN_CHECK: Final = 0.5
"""Time between two looks at whether the process that started the monitor is still there [s]."""


class LatencyMonitor:
    """Context in which a separate process measures stalls with one thread per core that repeatedly sleeps.

    A stall is the time by which a thread oversleeps. The process ends with the one that started it, however that ends.

    Args:
        pause: Duration of a sleep [s].
    """

    def __init__(self, pause: float = 0.002) -> None:
        self._pause = pause

    def __enter__(self) -> Self:
        """Start the process; raises DeviceError when it does not start."""
        cores = sorted(os.sched_getaffinity(0))
        fd = os.memfd_create("toolee-latency-monitor")
        try:
            os.truncate(fd, 2 * len(cores) * 8)
            self._longest, self._count = _shared(fd)
            self._longest[:] = -1.0
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(fd), str(os.getpid()), str(self._pause), *map(str, cores)],
                pass_fds=(fd,),
                start_new_session=True,  # so that it does not receive Ctrl-C
            )
        finally:
            os.close(fd)
        while self._longest.min() < 0.0:
            if self._process.poll() is not None:
                raise DeviceError("the latency monitor's process died at its start")
            time.sleep(self._pause)
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()

    @property
    def pid(self) -> int:
        """Process id of the monitor's process."""
        return self._process.pid

    def begin(self) -> None:
        """Reset the measurement."""
        self._longest[:] = self._count[:] = 0.0

    @property
    def longest(self) -> float:
        """Longest stall of any core since `begin` [s]."""
        return float(self._longest.max())

    @property
    def count(self) -> int:
        """Number of stalls longer than STALL since `begin`, of the core with the most."""
        return int(self._count.max())


def _shared(fd: int) -> Array:
    """Shared array, (2, cores): the longest stall [s], and the number of stalls."""
    return np.frombuffer(mmap.mmap(fd, 0)).reshape(2, -1)


def _watch(fd: int, parent: int, pause: float, cores: list[int]) -> None:
    longest, count = _shared(fd)
    gc.disable()
    with suppress(OSError):  # not permitted, in which case the measured software is not permitted either
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
        while os.getppid() == parent:
            time.sleep(ORPHAN_CHECK)


if __name__ == "__main__":
    _watch(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), [int(core) for core in sys.argv[4:]])
