"""What happened on the wire to a hand."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class LineCounts:
    """What happened on the wire so far."""

    requests: int = 0
    """Requests sent, repeated ones included."""
    unanswered: int = 0
    """Requests that nothing usable came back for."""
    corrupt: int = 0
    """Replies that were found damaged."""
    late: int = 0
    """Replies that were older than one that was there already, repeated ones included."""
