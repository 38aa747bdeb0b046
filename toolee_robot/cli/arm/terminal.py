"""The person at the terminal, who confirms each motion and whose key stops it."""

from __future__ import annotations

import select
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console

from toolee_robot.cli.terminal import require_terminal
from toolee_robot.errors import PersonNearError


class TerminalPerson:
    """A `hal.Person` at the terminal: the switch counts as held from a confirmation until any key is pressed.

    A terminal is no enabling switch. Nothing here notices that the person has gone, and a key takes part in no safety
    function: the person needs the robot's own emergency stop in the hand. The person counts as within reach, so that
    nothing fast ever moves, and no question of a job is answered with yes.

    Args:
        console: Where the questions go.
        absent: Whether nobody is asked: for scripts with a stand-in.

    Raises:
        UserError: The standard input is no terminal.
    """

    def __init__(self, console: Console, *, absent: bool = False) -> None:
        if not absent:
            require_terminal("a person confirms each motion", "with a stand-in, --yes asks nobody")
        self._console, self._absent, self._enabled = console, absent, False

    def confirm(self, question: str) -> None:
        """Ask whether the arm may move.

        Args:
            question: The question.

        Raises:
            PersonNearError: The answer is not an empty line.
        """
        if self._absent:
            return
        self._console.print(f"{question} [bold]Enter: yes. n, Enter: no.[/bold] Then any key stops it.", end=" ")
        if sys.stdin.readline() != "\n":
            raise PersonNearError("not confirmed: nothing was moved", code="person_near.not_confirmed")

    @contextmanager
    def attending(self) -> Iterator[None]:
        """Context of what was confirmed: the hold-to-run switch counts as held until a key is pressed."""
        if self._absent:
            self._enabled = True
            try:
                yield
            finally:
                self._enabled = False
            return
        fd = sys.stdin.fileno()
        before = termios.tcgetattr(fd)
        tty.setcbreak(fd)  # keys arrive one by one; Ctrl-C still interrupts
        self._enabled = True
        try:
            yield
        finally:
            self._enabled = False
            termios.tcsetattr(fd, termios.TCSAFLUSH, before)

    def hold_to_run_held(self) -> bool:
        """Whether a motion was confirmed and no key was pressed since; also false once the terminal is closed."""
        if self._enabled and not self._absent and select.select([sys.stdin], [], [], 0.0)[0]:
            self._enabled = False
        return self._enabled

    def readings_certain(self) -> bool:
        """See `hal.Person`."""
        return False

    def zone_occupied(self) -> bool:
        """See `hal.Person`: the person at the terminal may be anywhere."""
        return True

    def request_handover(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """See `hal.Person`."""
        return False

    release = take_tool = confirm_swing = confirm_inspection = hold_switch = request_handover
