"""What commands print: tables, progress and pages, and what a person hears while a job runs."""

from __future__ import annotations

import signal
import sys
import termios
import time
import tty
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
from rich.status import Status
from rich.table import Table

from toolee_robot.errors import PersonNearError, UserError
from toolee_robot.runtime.clock import readable
from toolee_robot.runtime.files import json_line

Flag = Annotated[bool, tyro.conf.arg(help_behavior_hint="")]
"""A flag, off by default."""
STATION = tyro.conf.arg(name="station", metavar="YAML", help_behavior_hint="")
"""The station file, where a command can do without."""


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


YES = "yes"
"""The only answer that agrees."""


def require_terminal(what: str, yes: str) -> None:
    """Refuse to go on where nobody can be asked.

    Args:
        what: What a person does at the terminal.
        yes: When --yes asks nobody instead.

    Raises:
        UserError: The standard input is no terminal.
    """
    if not sys.stdin.isatty():
        raise UserError(
            f"{what} at the terminal, but standard input is not a terminal. Start this command from a terminal ({yes})"
        )


def confirm_typed(console: Console, question: str) -> None:
    """Ask for a word: a key that is pressed by mistake answers nothing.

    Args:
        console: Where the question goes.
        question: The question.

    Raises:
        PersonNearError: The answer is another one.
    """
    console.print(f"{escape(question)} [bold]Type {YES}:[/bold]", end=" ", soft_wrap=True)
    if sys.stdin.readline().strip() != YES:
        raise PersonNearError("not confirmed: nothing was moved")


class TerminalPerson:
    """A `hal.Person` at the terminal: the switch counts as held from a confirmation until any key is pressed.

    A terminal is no enabling switch. Nothing here notices that the person has gone, and a key takes part in no safety
    function: the person needs the robot's own emergency stop in the hand. The person counts as within reach, so that
    nothing fast ever moves, and no question of a job is answered with yes. If `absent`, nobody is within reach, and
    every question is.

    Args:
        console: Where the questions go.
        absent: Whether nobody is asked: for scripts with a stand-in.

    Raises:
        UserError: The standard input is no terminal.
    """

    def __init__(self, console: Console, *, absent: bool = False) -> None:
        if not absent:
            require_terminal("a person confirms each motion", "with an emulated robot, --yes asks nobody")
        self._console, self._absent, self._enabled = console, absent, False

    def confirm(self, question: str) -> None:
        """Ask whether the arm may move; PersonNearError unless the answer is an empty line."""
        if self._absent:
            return
        self._console.print(f"{question} [bold]Enter: yes. n, Enter: no.[/bold] Then any key stops it.", end=" ")
        if sys.stdin.readline() != "\n":
            raise PersonNearError("not confirmed: nothing was moved")

    @contextmanager
    def attending(self) -> Iterator[None]:
        """Context of what was confirmed: the hold-to-run switch counts as held until a key is pressed."""
        before = None if self._absent else termios.tcgetattr(sys.stdin.fileno())
        if before is not None:
            tty.setcbreak(sys.stdin.fileno())  # keys arrive one by one; Ctrl-C still interrupts
        self._enabled = True
        try:
            yield
        finally:
            self._enabled = False
            if before is not None:
                termios.tcsetattr(sys.stdin.fileno(), termios.TCSAFLUSH, before)

    def hold_to_run_held(self) -> bool:
        """Whether a motion was confirmed and no key was pressed since; also false once the terminal is closed."""
        if self._enabled and not self._absent and readable([sys.stdin.fileno()], 0.0):
            self._enabled = False
        return self._enabled

    def readings_certain(self) -> bool:
        """See `hal.Person`."""
        return False

    def zone_occupied(self) -> bool:
        """See `hal.Person`: the person at the terminal may be anywhere."""
        return not self._absent

    def request_handover(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """See `hal.Person`."""
        return self._absent

    release = take_tool = confirm_swing = confirm_inspection = hold_switch = request_handover


@dataclass(frozen=True)
class ConsoleListener:
    """An `app.sources.Listener` at the terminal. Of what it shows, only `say` and `waiting` take markup."""

    console: Console
    """Where it prints."""

    def say(self, text: str) -> None:
        """See `Listener`."""
        self.console.print(text, soft_wrap=True)

    def warn(self, text: str) -> None:
        """See `Listener`."""
        self.console.print(f"  [yellow]{escape(text)}[/yellow]", soft_wrap=True)

    def prompt(self, text: str) -> None:
        """See `Listener`."""
        self.console.print(f"  [bold yellow]> {escape(text)}[/bold yellow]", soft_wrap=True)

    def doing(self, text: str) -> None:
        """See `Listener`."""
        self.console.print(f"[dim]{escape(text)}[/dim]", soft_wrap=True)

    def waiting(self, text: str) -> Status:
        """See `Listener`."""
        return self.console.status(text)
