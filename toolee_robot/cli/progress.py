"""Progress display of long commands."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

Report = Callable[[str, int, int], None]
"""report(what, done, total)."""
_BETWEEN = 10.0  # [s] between lines on a stream that is not a terminal


@contextmanager
def progress_bars(console: Console) -> Iterator[Report]:
    """Context that shows progress: bars with the estimated remaining time on a terminal, else a line every 10 s.

    Args:
        console: The console.

    Yields:
        The function to call with the name of the work, the amount done, and the total.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    remaining = (TextColumn("left"), TimeRemainingColumn())
    live = console.is_terminal
    # Results come in bursts: a long averaging period gives the better estimate.
    bars = Progress(
        *columns, *remaining, console=console, speed_estimate_period=600.0, transient=True, disable=not live
    )
    begun: dict[str, tuple[TaskID, float, int]] = {}
    told = -_BETWEEN

    def report(what: str, done: int, total: int) -> None:
        nonlocal told
        now = time.monotonic()
        if what not in begun:
            begun[what] = bars.add_task(what), now, done
        task, began, first = begun[what]
        bars.update(task, completed=done, total=total)
        if not live and (now - told > _BETWEEN or done == total):
            told = now
            rate = (done - first) / max(now - began, 1e-9)
            left = f", {rate:.1f}/s, {(total - done) / rate:.0f} s left" if rate > 0 else ""
            console.print(f"{what}: {done}/{total}{left}")

    with bars:
        yield report
