"""What other programs take of this machine's cores, by what Linux counts in /proc (proc(5))."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

PERIOD = 1.0
"""Time over which the load is measured [s]."""
_PROC = Path("/proc")
_IDLE = slice(3, 5)  # idle and iowait among the columns of /proc/stat


def load_of_others() -> float | None:
    """Measure the share of all cores' time that other programs take than this one and its children, 0 to 1.

    It takes PERIOD. The time that the host of a virtual machine takes counts, too.

    Returns:
        The share; None on an operating system without /proc.
    """
    with suppress(OSError):
        total, others = _ticks_so_far()
        time.sleep(PERIOD)
        total_now, others_now = _ticks_so_far()
        return min(max((others_now - others) / max(total_now - total, 1.0), 0.0), 1.0)
    return None


def _ticks_so_far() -> tuple[float, float]:
    """CPU time of all cores since the start, and that of other programs."""
    ticks = [int(column) for column in (_PROC / "stat").read_text().split("\n", 1)[0].split()[1:9]]
    return sum(ticks), sum(ticks) - sum(ticks[_IDLE]) - sum(_ticks(pid) for pid in _family(os.getpid()))


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
