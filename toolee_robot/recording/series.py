"""Values by time, and those that a recording has records for."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from toolee_robot.frames import Array

T = TypeVar("T")


class Series(Generic[T]):
    """Values by time, in the order of their stamps."""

    def __init__(self) -> None:
        self.stamps: list[float] = []
        self.values: list[T] = []

    def __len__(self) -> int:
        return len(self.stamps)

    def __iter__(self) -> Iterator[tuple[float, T]]:
        return iter(list(zip(self.stamps, self.values, strict=False)))

    def add(self, stamp: float, value: T) -> None:
        """Insert a value; most come in order.

        Args:
            stamp: Time [s].
            value: The value.
        """
        i = len(self.stamps) if not self.stamps or stamp >= self.stamps[-1] else bisect_right(self.stamps, stamp)
        self.values.insert(i, value)
        self.stamps.insert(i, stamp)

    def index(self, stamp: float) -> int:
        """Index of the newest value at a time [s]; -1 before the first."""
        return bisect_right(self.stamps, stamp) - 1

    def at(self, stamp: float) -> T | None:
        """The newest value at a time [s]; None before the first."""
        i = self.index(stamp)
        return None if i < 0 else self.values[i]


@dataclass(frozen=True, eq=False)
class SeenEstimate:
    """An estimate of an end effector's pose.

    Attributes:
        category: Category of the end effector.
        X: Its pose, (4, 4), in the camera's frame, or in the hand's after fusion; None where there is none.
        covariance: Covariance of position [m] and rotation vector [rad], (6, 6).
        trust: Probability that it is right, 0 to 1.
        usable: Whether it may be acted on.
        reason: Why not, or "ok".
        frames_used: Number of frames that it rests on.
        frames_seen: Number of frames that were looked at.
    """

    category: str
    X: Array | None
    covariance: Array
    trust: float
    usable: bool
    reason: str
    frames_used: int
    frames_seen: int


@dataclass(frozen=True)
class SeenStatus:
    """State of the robot's own safety system.

    Attributes:
        status: The state, a `hal.ArmStatus` in words.
        safety_bits: The controller's own bits; None where it has none, or the recording.
        error_code: Code that explains the last stop, such as C157A4; None where none is known, and likewise.
    """

    status: str
    safety_bits: int | None
    error_code: str | None


@dataclass(frozen=True)
class SeenDecision:
    """A decision.

    Attributes:
        stamp: Time [s].
        name: Its kind.
        reason: The reason, for a person.
        data: Its data, JSON values.
    """

    stamp: float
    name: str
    reason: str
    data: dict[str, Any]
