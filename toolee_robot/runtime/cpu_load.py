"""What other programs take of this machine's cores, by what Linux counts in /proc (proc(5))."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Self

PERIOD = 1.0
"""Time between two samples [s]."""
SAMPLES = 10
"""Number of samples that are kept: the load of the last ten seconds is told."""
_PROC = Path("/proc")
_IDLE = slice(3, 5)  # idle and iowait among the columns of /proc/stat


class CpuLoad:
    """Context in which the cores' use by other programs than this one and its children is sampled.

    On an operating system without /proc nothing is known.
    """

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque(maxlen=SAMPLES + 1)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._sample, name="cpu load", daemon=True)

    def __enter__(self) -> Self:
        """Start the samples."""
        self._take()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def others(self) -> float | None:
        """Share of all cores' time that other programs took in the last ten seconds, 0 to 1; None where unknown.

        The time that the host of a virtual machine takes counts, too.
        """
        self._take()
        samples = list(self._samples)
        if len(samples) < 2:
            return None
        (total, others), (total_now, others_now) = samples[0], samples[-1]
        return min(max((others_now - others) / max(total_now - total, 1.0), 0.0), 1.0)

    def _sample(self) -> None:
        while not self._over.wait(PERIOD):
            self._take()

    def _take(self) -> None:
        with suppress(OSError):
            ticks = [int(column) for column in (_PROC / "stat").read_text().split("\n", 1)[0].split()[1:9]]
            own = sum(_ticks(pid) for pid in _family(os.getpid()))
            self._samples.append((sum(ticks), sum(ticks) - sum(ticks[_IDLE]) - own))


def _family(pid: int) -> Iterator[int]:
    """A process and its living descendants; one that has just ended has none."""
    yield pid
    for task in (_PROC / str(pid) / "task").glob("*/children"):
        with suppress(FileNotFoundError, ProcessLookupError):
            for child in task.read_text().split():
                yield from _family(int(child))


def _ticks(pid: int) -> int:
    """CPU time of a process and of its children that have ended."""
    try:
        text = (_PROC / str(pid) / "stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return 0
    return sum(int(field) for field in text.rpartition(")")[2].split()[11:15])
