"""Figures of trials: shares with intervals, paired comparisons, and success against the size of an error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import binomtest

from toolee_robot.app.variant import Variant
from toolee_robot.trials.results import Record


@dataclass(frozen=True)
class Share:
    """A share with its 95 % interval.

    Attributes:
        hits: Number of successes.
        of: Number of trials.
        low: Lower bound (Wilson 1927).
        high: Upper bound.
    """

    hits: int
    of: int
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.hits} of {self.of} ({self.low:.2f} to {self.high:.2f})"


def share(successes: Sequence[bool]) -> Share:
    """Compute a share.

    Args:
        successes: Whether each trial succeeded; at least one.

    Returns:
        The share.
    """
    hits, of = int(sum(successes)), len(successes)
    interval = binomtest(hits, of).proportion_ci(method="wilson")
    return Share(hits, of, float(interval.low), float(interval.high))


@dataclass(frozen=True)
class Comparison:
    """An arm compared with another one on the same seeds.

    Attributes:
        pairs: Number of seeds that both have.
        better: Number of seeds where only the arm succeeded.
        worse: Number of seeds where only the other one did.
        p: Probability of a difference at least as large if there is none (exact test of McNemar 1947).
    """

    pairs: int
    better: int
    worse: int
    p: float


def compare(arm: Sequence[Record], other: Sequence[Record]) -> Comparison:
    """Compare two arms, pair by pair.

    Args:
        arm: Results of an arm.
        other: Results of the arm that it is compared with.

    Returns:
        The comparison.
    """
    reference = {replace(record.trial, arm=Variant.FULL): record.success for record in other}
    mine = [(r.success, replace(r.trial, arm=Variant.FULL)) for r in arm]
    pairs = [(success, reference[trial]) for success, trial in mine if trial in reference]
    better = sum(a and not b for a, b in pairs)
    worse = sum(b and not a for a, b in pairs)
    p = 1.0 if better + worse == 0 else float(binomtest(better, better + worse, 0.5).pvalue)
    return Comparison(len(pairs), better, worse, p)


def median(records: Sequence[Record], figure: str) -> float | None:
    """Median of a figure.

    Args:
        records: The results.
        figure: Its name.

    Returns:
        The median over those that have it; None if none has.
    """
    known = [value for record in records if (value := record.figures.get(figure)) is not None]
    return float(np.median(known)) if known else None


def of_arm(records: Sequence[Record], arm: Variant) -> list[Record]:
    """The results of an arm.

    Args:
        records: All results.
        arm: The arm.

    Returns:
        Its results, in their order.
    """
    return [record for record in records if record.trial.arm is arm]


def by_conditions(records: Sequence[Record]) -> dict[str, list[Record]]:
    """Sort results by tool, nail, wood and sensor.

    Args:
        records: The results.

    Returns:
        By their names in words; nothing where the plan lists none.
    """
    sorted_: dict[str, list[Record]] = {}
    for record in records:
        if words := record.trial.conditions:
            sorted_.setdefault(words, []).append(record)
    return sorted_
