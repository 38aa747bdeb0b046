"""Sweeps: how success depends on the size of one error while the others stay, and the size that is too much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from toolee_robot.frames import Array
from toolee_robot.trials.panels import BLUE, RED, errors, panels, png, rates
from toolee_robot.trials.plan import TrialPlan
from toolee_robot.trials.results import Record
from toolee_robot.trials.statistics import Share, share

ENOUGH = 0.9
"""Share of successes under which an error is too large."""
LEAST_SEEDS = 10
"""Number of seeds from which on a limit is told: of fewer neither the curve nor its interval means anything."""
RESAMPLED = 200
"""Number of times that the seeds are drawn again for the interval of a limit."""
UNITS = {
    "camera_position": ("camera's place, mm along each axis", 1e3),
    "camera_rotation": ("camera's orientation, ° about each axis", 180.0 / np.pi),
    "nail_beside": ("nail beside its place, mm along x and y", 1e3),
    "nail_height": ("wood's height, mm", 1e3),
    "nail_lean": ("nail's lean, ° to each side", 180.0 / np.pi),
    "ruler": ("lengths on the tool, mm", 1e3),
    "face_angle": ("direction of the face, °", 180.0 / np.pi),
    "scales": ("tool's mass, %", 100.0),
    "balance": ("centre of mass, mm", 1e3),
    "kinematics": ("arm's lengths and angles, mm and mrad", 1e3),
    "wood": ("specific gravity, %", 100.0),
    "friction": ("friction in the hand, %", 100.0),
    "payload": ("hand's mass, %", 100.0),
    "wrench": ("force: noise, offset, drift, times the generation's", 1.0),
    "compliance": ("joints' compliance, times the nominal one", 1.0),
    "handover": ("handover, times the nominal range", 1.0),
    "other_tool": ("tool's data, % of the way to another hammer's", 100.0),
}
"""How the axis of each swept error is called, and the factor from the plan's unit to the axis's."""


@dataclass(frozen=True)
class Limit:
    """The size of an error at which the share of successes falls under `ENOUGH`.

    A logistic curve is fitted to the trials; the 95 % interval is of fits to seeds drawn again (bootstrap).

    Attributes:
        size: That size; the largest one of the sweep where the curve does not fall so far.
        low: Lower bound.
        high: Upper bound; the largest one of the sweep where it may lie beyond.
    """

    size: float
    low: float
    high: float


@dataclass(frozen=True)
class Sweep:
    """Trials of one error.

    Attributes:
        error: Its name.
        sizes: The sizes, from small to large, in the plan's unit.
        shares: Share of successes at each.
        limit: The size that is too much; None where there are too few seeds to tell.
        seeds: Number of seeds.
    """

    error: str
    sizes: tuple[float, ...]
    shares: tuple[Share, ...]
    limit: Limit | None
    seeds: int

    @property
    def axis(self) -> tuple[str, float]:
        """How its axis is called, and the factor from the plan's unit."""
        return UNITS.get(self.error, (self.error, 1.0))

    @property
    def told(self) -> str:
        """The limit, in words."""
        factor, least, end = self.axis[1], self.sizes[0], self.sizes[-1]
        limit = self.limit
        if limit is None:
            return f"too few seeds to tell, {LEAST_SEEDS} are needed"
        if limit.low <= least and limit.high >= end and len(self.sizes) > 1:
            return f"anywhere from {factor * least:.2g} on: {self.seeds} seeds do not tell"
        if limit.size >= end:
            return f"not up to {factor * end:.3g}"
        at, low = (
            f"{factor * size:.2g}" if size > least else f"{factor * least:.2g} or less"
            for size in (limit.size, limit.low)
        )
        return f"{at} ({low} to {factor * limit.high:.2g}{' or more' if limit.high >= end else ''})"


def sweeps(plan: TrialPlan, records: Sequence[Record]) -> list[Sweep]:
    """Sort an arm's trials by the error that was swept.

    The trials in which no error has a size of its own are in every sweep, with the size that its error has there.

    Args:
        plan: The plan.
        records: The results of one arm.

    Returns:
        The sweeps, in the plan's order; none for a plan without.
    """
    # The simulation takes a second to import, which no other plan's report needs.
    from toolee_robot.sim_backend.cell_errors import NOMINAL

    given = plan.errors if isinstance(plan.errors, dict) else {}
    usual = [record for record in records if record.trial.error is None]
    found = []
    for error in plan.sweep:
        size = given.get(error, getattr(NOMINAL, error))
        sized = [(r.trial.size, r) for r in records if r.trial.error == error and r.trial.size is not None]
        if sized or usual:
            found.append(_sweep(error, sized + [(size, record) for record in usual]))
    return found


def _sweep(error: str, sized: Sequence[tuple[float, Record]]) -> Sweep:
    sizes = np.array([size for size, _ in sized])
    flush = np.array([record.success for _, record in sized])
    seeds = np.array([record.trial.seed for _, record in sized])
    tried = np.unique(sizes)
    shares = tuple(share([bool(value) for value in flush[sizes == size]]) for size in tried)
    return Sweep(error, tuple(tried.tolist()), shares, _limit(sizes, flush, seeds), len(np.unique(seeds)))


def _limit(sizes: Array, flush: NDArray[np.bool_], seeds: NDArray[np.int64]) -> Limit | None:
    rng = np.random.default_rng(0)
    rows = [np.flatnonzero(seeds == seed) for seed in np.unique(seeds)]
    if len(rows) < LEAST_SEEDS:
        return None
    drawn = []
    for _ in range(RESAMPLED):
        again = np.concatenate([rows[i] for i in rng.integers(len(rows), size=len(rows))])
        drawn.append(_too_much(sizes[again], flush[again], float(sizes.max())))
    low, high = np.quantile(drawn, [0.025, 0.975])
    return Limit(_too_much(sizes, flush, float(sizes.max())), float(low), float(high))


def _too_much(sizes: Array, flush: NDArray[np.bool_], end: float) -> float:
    """Where a logistic curve through the trials falls under `ENOUGH`, from 0 to `end`."""
    x, sign = sizes / end, np.where(flush, 1.0, -1.0)

    def loss(w: Array) -> tuple[float, Array]:
        """The loss and its gradient."""
        # Half a success and half a failure, spread over the sizes, keep a curve through separable trials finite.
        z = w[0] - w[1] * x
        spread = np.mean(np.logaddexp(0.0, z) + np.logaddexp(0.0, -z))
        by_z = (expit(z) - 0.5) / len(x) - sign * expit(-sign * z)
        return float(np.sum(np.logaddexp(0.0, -sign * z)) + 0.5 * spread), np.array([by_z.sum(), -by_z.dot(x)])

    level, slope = minimize(loss, np.array([2.0, 2.0]), method="BFGS", jac=True).x
    needed = np.log(ENOUGH / (1.0 - ENOUGH))
    if level <= needed:
        return 0.0
    return float(end * min((level - needed) / slope, 1.0)) if slope > 0.0 else end


def curves(found: Sequence[Sweep]) -> bytes:
    """Draw sweeps.

    Args:
        found: The sweeps, at least one.

    Returns:
        A PNG.
    """
    figure, axes = panels(len(found))
    for ax, sweep in zip(axes, found, strict=True):
        name, factor = sweep.axis
        x = factor * np.array(sweep.sizes)
        ax.errorbar(x, rates(sweep.shares), yerr=errors(sweep.shares), fmt="o-", color=BLUE, capsize=3)
        ax.axhline(ENOUGH, color=RED, linewidth=0.8, linestyle="--")
        limit = sweep.limit
        if limit is not None and limit.size < sweep.sizes[-1]:
            ax.axvspan(factor * limit.low, factor * limit.high, color=RED, alpha=0.12, linewidth=0)
        ax.set_xlabel(name)
        ax.set_xlim(left=0.0)
    return png(figure)
