"""A person at the terminal: whether there is one, and a question that is answered with a word."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.markup import escape

from toolee_robot.errors import PersonNearError, UserError

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
            f"{what} at the terminal, and the standard input is none: start it from one ({yes})",
            code="user.no_terminal",
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
        raise PersonNearError("not confirmed: nothing was moved", code="person_near.not_confirmed")
