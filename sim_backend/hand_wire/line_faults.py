"""Faults of the line: what becomes of a reply on its way, and of what is written."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

T = TypeVar("T")


class LineFault(StrEnum):
    """What can become of a reply."""

    GARBAGE = "garbage"
    """Noise comes before it."""
    CORRUPT = "corrupt"
    """One of its bytes is another, or a burst of them are."""
    SHORT = "short"
    """Its end is missing."""
    LATE = "late"
    """It comes after the driver has given up on it."""
    DOUBLED = "doubled"
    """It comes twice."""
    FOREIGN = "foreign"
    """The reply of another hand comes before it."""
    LOST = "lost"
    """It does not come."""


class WriteFault(StrEnum):
    """What can become of what is written, while everything that is asked is answered."""

    DEAF = "deaf"
    """It is neither carried out nor acknowledged."""
    UNACKNOWLEDGED = "unacknowledged"
    """It is carried out, and not acknowledged."""


ACKNOWLEDGE = "acknowledge"
"""Event that ends a `WriteFault`."""


@dataclass(frozen=True)
class Piece:
    """Bytes on the line."""

    data: bytes
    """The bytes."""
    delay: float
    """Time that passes before them [s]."""


class LineFaults:
    """Injects faults into the replies; from any thread.

    Args:
        foreign: Makes a reply of another hand on the line out of one of this hand.
        seed: Seed of the noise, and of faults at random.
        framing: Number of a reply's first bytes in which noise can hit; None for all of them. On TCP, whose checksum
            covers the data, what a hand could send wrong is its framing.
        burst: Bytes of a damaged reply that are others.

    Attributes:
        muted: Whether no reply comes at all.
        writes: What becomes of everything that is written; None: it is carried out and acknowledged.
        echo: Whether the adapter repeats what it was sent, as two-wire ones do.
        rates: Probability of each fault for each reply.
        late_by: By how much late replies are late [s].
    """

    def __init__(
        self, foreign: Callable[[bytes], bytes], seed: int = 0, framing: int | None = None, burst: int = 1
    ) -> None:
        self._foreign, self._framing, self._burst = foreign, framing, burst
        self.muted = self.echo = False
        self.writes: WriteFault | None = None
        self.rates: Mapping[LineFault, float] = {}
        self.late_by = 0.12
        self._random = random.Random(seed)
        self._next: deque[LineFault] = deque()

    def upcoming(self, fault: LineFault, count: int = 1) -> None:
        """Let a fault happen to the next replies.

        Args:
            fault: The fault.
            count: Number of replies.
        """
        self._next.extend([fault] * count)

    @property
    def pending(self) -> int:
        """Number of injected faults that have not happened yet."""
        return len(self._next)

    def write(self, carry_out: Callable[[], list[T]]) -> list[T]:
        """Let the hand take what is written, as far as `writes` lets it.

        Args:
            carry_out: Carries it out and returns what acknowledges it.

        Returns:
            What acknowledges it; nothing if nothing does.
        """
        if self.writes is WriteFault.DEAF:
            return []
        acknowledgement = carry_out()
        return acknowledgement if self.writes is None else []

    def on_the_way(self, frame: bytes) -> list[Piece]:
        """What arrives of a reply.

        Args:
            frame: The reply.

        Returns:
            What arrives, one after the other.
        """
        if self.muted:
            return []
        fault = self._next.popleft() if self._next else self._drawn()
        draw = self._random
        if fault is LineFault.GARBAGE:
            return [Piece(draw.randbytes(draw.randint(1, 30)) + frame, 0.0)]
        if fault is LineFault.CORRUPT:
            end = len(frame[: self._framing])
            at = draw.randrange(max(1, end - self._burst + 1))
            damaged = slice(at, min(at + self._burst, end))
            others = bytes(byte ^ draw.randint(1, 255) for byte in frame[damaged])
            return [Piece(frame[:at] + others + frame[damaged.stop :], 0.0)]
        if fault is LineFault.SHORT:
            return [Piece(frame[: draw.randrange(len(frame))], 0.0)]
        if fault is LineFault.LATE:
            return [Piece(frame, self.late_by)]
        if fault is LineFault.DOUBLED:
            return [Piece(frame, 0.0), Piece(frame, 0.0)]
        if fault is LineFault.FOREIGN:
            return [Piece(self._foreign(frame), 0.0), Piece(frame, 0.0)]
        return [] if fault is LineFault.LOST else [Piece(frame, 0.0)]

    def _drawn(self) -> LineFault | None:
        return next((fault for fault, rate in self.rates.items() if self._random.random() < rate), None)
