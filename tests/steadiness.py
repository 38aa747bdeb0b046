"""Whether the machine itself stands still at times: the host of a virtual machine takes its cores away without a word,
and no real-time priority helps against that."""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import os
import threading
import time
from contextlib import suppress
from types import TracebackType

PAUSE = 0.002  # [s]
PRIORITY = 60
"""Of SCHED_FIFO: over the driver's (40) and the stand-in's (1), so that what they do to each other is never put down to
the machine."""


class Steadiness:
    """A process beside the tests with a thread on each core that sleeps for PAUSE again and again, and sees by how much
    it overslept."""

    def __enter__(self) -> Steadiness:
        spawn = multiprocessing.get_context("spawn")
        cores = sorted(os.sched_getaffinity(0))
        self._longest = spawn.RawArray(ctypes.c_double, [-1.0] * len(cores))
        self._process = spawn.Process(target=_watch, args=(self._longest, cores), daemon=True)
        self._process.start()
        while min(self._longest) < 0.0:  # not watching yet
            if not self._process.is_alive():
                raise RuntimeError("the process that watches the machine's steadiness died at its start")
            time.sleep(PAUSE)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.join()

    def begin(self) -> None:
        """Forget what was."""
        for i in range(len(self._longest)):
            self._longest[i] = 0.0

    @property
    def standstill(self) -> float:
        """[s] The longest since `begin`, of any core."""
        return max(self._longest)


def _watch(longest: ctypes.Array[ctypes.c_double], cores: list[int]) -> None:
    gc.disable()
    with suppress(OSError):  # not permitted: nor is it to the programs under test
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    for i, core in enumerate(cores):
        threading.Thread(target=_sleep, args=(longest, i, core), daemon=True).start()
    threading.Event().wait()


def _sleep(longest: ctypes.Array[ctypes.c_double], i: int, core: int) -> None:
    os.sched_setaffinity(0, {core})
    longest[i] = 0.0
    before = time.monotonic()
    while True:
        time.sleep(PAUSE)
        now = time.monotonic()
        longest[i] = max(longest[i], now - before - PAUSE)
        before = now
