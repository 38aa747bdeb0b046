"""Figures of trials: shares with intervals, paired comparisons, and success against the size of each drawn error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BytesIO

import numpy as np
from matplotlib.figure import Figure
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


ERRORS = {
    "camera_mm": "camera's place, mm",
    "camera_deg": "camera's orientation, °",
    "nail_beside_mm": "nail beside its place, mm",
    "nail_height_mm": "wood's height, mm",
    "nail_lean_deg": "lean of the nail, °",
    "face_mm": "face on the tool, mm",
    "face_deg": "direction of the face, °",
    "handle_mm": "radius of the handle, mm",
    "mass_percent": "tool's mass, %",
    "balance_mm": "tool's centre of mass, mm",
    "kinematics_mm": "lengths of the arm, mm",
    "wood_percent": "specific gravity of the wood, %",
    "friction_percent": "friction of hand and handle, %",
    "payload_percent": "hand's mass, %",
    "wrench_percent": "errors of the force, % of its generation's",
    "compliance_percent": "compliance of the joints, % of the nominal one",
    "handover_mm": "handover: shift along the handle, mm",
    "handover_spin_deg": "handover: turn about the handle, °",
    "handover_tilt_deg": "handover: tilt of the handle, °",
    "other_tool_percent": "tool's data, % of the way to another hammer's",
}
"""Errors against which success is shown, and how the axis is called."""
BLUE, COLUMNS = "#12609e", 3
"""Of the diagrams."""


@dataclass(frozen=True)
class Bin:
    """Trials whose error is of about one size.

    Attributes:
        low: Least size.
        high: Largest size.
        share: Share of successes.
    """

    low: float
    high: float
    share: Share


def by_size(records: Sequence[Record], error: str, bins: int = 4) -> list[Bin]:
    """Sort trials by the size of one drawn error, into bins of about as many trials each.

    Args:
        records: The results.
        error: Name of the error, as in `errors` of a summary.
        bins: Number of bins.

    Returns:
        The bins, from small to large errors; empty where the error was not drawn or is the same everywhere.
    """
    sizes = [(r.figures.get("errors") or {}).get(error) for r in records]
    known = sorted((abs(size), i) for i, size in enumerate(sizes) if size is not None)
    if len(known) < bins or known[0][0] == known[-1][0]:
        return []
    parts = np.array_split(np.array(known), bins)
    return [Bin(part[0, 0], part[-1, 0], share([records[int(i)].success for i in part[:, 1]])) for part in parts]


def curves(records: Sequence[Record]) -> bytes | None:
    """Draw the shares against the size of each error.

    Args:
        records: The results.

    Returns:
        A PNG; None where no error was drawn, or there are too few trials for bins.
    """
    drawn = {name: bins for name in ERRORS if (bins := by_size(records, name))}
    if not drawn:
        return None
    rows = -(-len(drawn) // COLUMNS)
    figure = Figure(figsize=(10.5, 2.8 * rows), layout="constrained")
    axes = figure.subplots(rows, COLUMNS, squeeze=False, sharey=True).ravel()
    for ax in axes[len(drawn) :]:
        ax.set_visible(False)
    for ax in axes[::COLUMNS]:
        ax.set_ylabel("flush")
    for ax, (name, bins) in zip(axes, drawn.items(), strict=False):
        low, high = np.array([b.low for b in bins]), np.array([b.high for b in bins])
        y = np.array([b.share.hits / b.share.of for b in bins])
        off = np.maximum([y - [b.share.low for b in bins], [b.share.high for b in bins] - y], 0.0)
        ax.errorbar((low + high) / 2, y, yerr=off, xerr=(high - low) / 2, fmt="o", color=BLUE, capsize=2)
        ax.set_ylim(-0.03, 1.03)
        ax.set_xlabel(ERRORS[name])
        ax.grid(alpha=0.3)
    file = BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return file.getvalue()
