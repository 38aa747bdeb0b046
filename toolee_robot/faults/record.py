"""One row of the fault matrix: what was injected, when, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Phase(StrEnum):
    """When the fault comes."""

    START = "at the start"
    REST = "at rest"
    SWING = "in mid-swing"


@dataclass(frozen=True)
class FaultRow:
    """number: in the list of docs/concepts/safety.md. fault: what was injected. on: the arm it was injected under.
    expected: the reaction it must get. got: the one it got.

    reaction: from the fault to the first tick in which the joints leave the uninterrupted motion [s]. standstill: from
    the fault to rest [s]; allowed: the most that may take [s], which is the time to notice it, the braking that the
    limits force, and two cycles. speed: of the fastest joint when it came [rad/s].
    off_path: the most that the joints left the path afterwards [rad]. None where nothing moved or nothing is timed.
    latched: whether the next motion was refused until a person's reset. handled: all of it as it must be; why: if not.
    again: how often it was measured before, to no avail, while the machine itself stalled or the moment was missed.
    """

    number: int
    fault: str
    phase: Phase
    on: str
    expected: str
    got: str
    latched: bool
    handled: bool
    why: str = ""
    reaction: float | None = None
    standstill: float | None = None
    allowed: float | None = None
    speed: float | None = None
    off_path: float | None = None
    again: int = 0
