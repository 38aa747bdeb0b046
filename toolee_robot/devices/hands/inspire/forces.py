"""From the force registers' counts to newtons."""

from __future__ import annotations

NEWTONS = {
    "index": (0.007478, -0.414),
    "middle": (0.006452, 0.018),
    "thumb": (0.012547, 0.384),
    "ring": (0.006452, 0.018),
    "little": (0.006452, 0.018),
}
"""Newtons for each count, and at 0 counts [N]: index, middle and thumb were measured on one hand between 100 and 1000
counts (Tan, Xie and Correll, 2025); ring and little finger are taken to be like the middle one. The manual calls a
count a gram, which would be 0.0098 N."""
_SMALLEST = 20
"""Counts that are no more than the sensors' drift."""


def newtons(finger: str, counts: int) -> float:
    """Convert a force.

    Args:
        finger: A key of NEWTONS.
        counts: The register's value.

    Returns:
        The force [N], 0 for one that is not above the drift.
    """
    slope, at_zero = NEWTONS[finger]
    return 0.0 if counts < _SMALLEST else max(0.0, slope * counts + at_zero)
