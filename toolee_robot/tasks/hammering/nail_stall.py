"""Whether strikes still drive the nail: against what they are expected to do, and as surely as a measurement tells."""

from __future__ import annotations

import math

FEWEST, MOST = 2, 6
"""Number of strikes that tell that a nail stands still: of fast ones, and of those that drive it by so little that a
measurement hardly tells it."""
TELLS = 0.001
"""What strikes are expected to drive the nail together before a measurement tells that they did not [m]: 2.6 standard
deviations of the difference of two heights, which err by 0.27 mm each (`docs/results/job.md`)."""
SHARE = 0.5
"""Of the expected progress below which a nail that moves slowly is taken to stand still."""


class NailStall:
    """The strikes that seem not to have moved the nail.

    Near the end of its way a nail may move by less than `least` in every strike of a slow arm, and still goes in: so
    where little is expected, less is asked for, and more strikes have to tell.

    Args:
        least: Progress of a strike below which it has not moved the nail, unless less is expected [m].

    Attributes:
        strikes: Number of the latest strikes that together have not moved the nail.
        moved: What they have moved it by [m].
        suspected: Whether the last measurement makes one suspect that it stands still.
    """

    def __init__(self, least: float) -> None:
        self.strikes, self.moved = 0, 0.0
        self._least = self._usual = least
        self._needed = FEWEST
        self.suspected = False

    def __str__(self) -> str:
        return f"{self.strikes} strikes moved the head by {max(self.moved, 0.0) * 1e3:.1f} mm together"

    @property
    def over(self) -> bool:
        """Whether the nail stands still, as surely as its heights tell."""
        return self.strikes >= self._needed

    def measured(self, strikes: int, progress: float, expected: float | None) -> None:
        """Take over a measurement.

        Args:
            strikes: Number of strikes since the one before.
            progress: Their mean progress [m].
            expected: What was expected of it [m]; None if nothing was.
        """
        if not self.suspected and expected is not None:
            self._least = min(self._usual, SHARE * expected)
            self._needed = max(math.ceil(TELLS / max(expected, TELLS / MOST)), FEWEST)
        self.strikes, self.moved = self.strikes + strikes, self.moved + strikes * progress
        self.suspected = self.moved < self._least * self.strikes
        if not self.suspected:
            self.again()

    def again(self) -> None:
        """Count anew, with what was expected of the strikes so far: the tool was looked at."""
        self.strikes, self.moved = 0, 0.0
