"""What commands share: flags, output for people and programs, tables, progress, and pages that are served."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from toolee_robot.runtime.files import json_line

Flag = Annotated[bool, tyro.conf.arg(help_behavior_hint="")]
"""A flag, off by default."""


@dataclass(frozen=True, kw_only=True)
class JsonOption:
    """A command that prints its result for programs, too."""

    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    @property
    def console(self) -> Console:
        """Where people read."""
        return Console(stderr=self.json, highlight=False)

    def tell(self, figures: Any) -> None:
        """Print figures as JSON, if that is asked for."""
        if self.json:
            print(json_line(figures), flush=True)


def text_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> Table:
    """Build a table for the terminal.

    Args:
        title: Title of the table.
        columns: Headings of the columns.
        rows: Cells of each row.
        left: Number of left-aligned columns.

    Returns:
        The table.
    """
    table = Table(title=escape(title), title_justify="left")
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < left else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


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


class Page(Protocol):
    """A page that is being served."""

    @property
    def address(self) -> str:
        """Its address."""

    def close(self) -> None:
        """Stop serving."""


def serve(page: Page, console: Console, ends: str = "Ctrl-C ends it.") -> None:
    """Tell a page's address, and close it at Ctrl-C, which may come as soon as the address is told.

    Args:
        page: The page.
        console: Where the address is told.
        ends: What Ctrl-C does.
    """
    with suppress(KeyboardInterrupt):
        console.print(f"Open [bold]{page.address}[/bold] in a browser. {ends}")
        signal.pause()
    page.close()
