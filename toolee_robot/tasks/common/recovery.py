"""Stops with the tool in the hand: how many a session may have, and what a person is told to do."""

from __future__ import annotations

MAX_STOPS = 3
"""Number of stops with the tool in the hand that end a session."""
_STANDS = "the arm stands still"
PUT_AWAY = f"{_STANDS}, put it away by hand"
"""What to do about an arm that stands without a tool."""
RESUME = (
    f"{_STANDS} with the tool in the hand. Look at robot, hand and tool, and make the robot ready; then "
    "resume the job, or take the tool out (take hold of it and have the hand opened), or put it away by hand"
)
"""What to do about a stop that can be cleared."""
TAKE_OUT = (
    f"{_STANDS} with the tool in the hand. Take hold of it and have the hand opened (`give_back` of the "
    "task, or the hand's own software); nothing opens it by itself"
)
"""What to do about a stop that cannot be cleared, or that ends the session."""


def cause(reason: str) -> str:
    """What ended a job, without what a person is to do about the arm.

    Args:
        reason: Why it ended, as a result tells it.

    Returns:
        The cause.
    """
    return reason.partition(f"; {_STANDS}")[0]


class Stops:
    """Counts the stops of a session.

    Attributes:
        count: Number of stops with the tool in the hand so far.
    """

    def __init__(self) -> None:
        self.count = 0

    @property
    def last(self) -> bool:
        """Whether the session has ended because of its stops."""
        return self.count >= MAX_STOPS

    def add(self, reason: str) -> str:
        """Count a stop with the tool in the hand.

        Args:
            reason: Why the arm was stopped.

        Returns:
            The reason, and what a person can do.
        """
        self.count += 1
        if self.last:
            return f"{reason}; stop {self.count} of {MAX_STOPS} ends the session: find the cause; {TAKE_OUT}"
        return f"{reason}; {RESUME}"
