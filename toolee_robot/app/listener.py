"""Who hears of what a function of this room does, while it does it."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Protocol


class Waiting(Protocol):
    """Work that takes a while."""

    def update(self, text: str, /) -> None:
        """What it does now."""


class Listener(Protocol):
    """A person at a terminal, or nobody."""

    def say(self, text: str) -> None:
        """What is going on."""

    def warn(self, text: str) -> None:
        """What the person should look at, although it goes on."""

    def prompt(self, text: str) -> None:
        """What the person is to do now."""

    def doing(self, text: str) -> None:
        """What a device is doing."""

    def waiting(self, text: str) -> AbstractContextManager[Waiting]:
        """Context of work that takes a while."""
