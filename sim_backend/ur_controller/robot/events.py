"""Requests of a script to the rest of the controller."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class EventKind(StrEnum):
    """Kinds of requests."""

    TEXT = "text"
    POPUP = "popup"
    PROTECTIVE_STOP = "protective_stop"
    HALT = "halt"
    PAUSE = "pause"
    STOP = "stop"


@dataclass(frozen=True)
class Event:
    """A request of the script.

    Attributes:
        kind: What is requested.
        text: Text or reason.
    """

    kind: EventKind
    text: str = ""
