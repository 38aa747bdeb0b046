"""Serving a page until the person at the terminal ends it."""

from __future__ import annotations

import signal
from contextlib import suppress
from typing import Protocol

from rich.console import Console


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
