"""How a hand moves a tool as its fingers close: the mean over earlier jobs, for jobs that only know that."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.errors import UserError, words_of
from toolee_robot.frames import Array, inverse, transform

LEAST_JOBS = 10
"""Number of jobs of which a mean is taken at least: of fewer the hand-overs themselves do not average out."""


@dataclass(frozen=True)
class LearntShift:
    """Mean motion of the tool from the nominal grasp to where the first look found it.

    Attributes:
        X_hand: That motion, about the hand's frame: X_hand_ee = X_hand @ nominal X_hand_ee, (4, 4) [m].
        jobs: Number of jobs.
        spread: Root mean square of what is left of it [m], and of its angle [rad].
    """

    X_hand: Array
    jobs: int
    spread: tuple[float, float]

    @property
    def figures(self) -> dict[str, Any]:
        """What a job says of it in its summary; `sha256` is equal for equal means."""
        digest = hashlib.sha256(np.round(self.X_hand, 9).tobytes()).hexdigest()
        spread = {
            "spread_mm": round(1e3 * self.spread[0], 2),
            "spread_deg": round(float(np.rad2deg(self.spread[1])), 2),
        }
        return {"jobs": self.jobs, **spread, "X_hand": self.X_hand.tolist(), "sha256": digest}


def learn_shifts(folder: Path) -> dict[str, LearntShift]:
    """Average the first looks of earlier jobs, each against its nominal grasp.

    Jobs of the whole system count, one for each seed: the others of a plan of trials saw the same hand-over.

    Args:
        folder: Folder whose runs are read, at any depth: a plan's trials, or several.

    Returns:
        The mean for each model of a hand with `LEAST_JOBS` such jobs or more.

    Raises:
        UserError: No hand has as many (`user.too_few_runs`), or a summary cannot be read (`user.unreadable_run`).
    """
    found: dict[str, list[Array]] = {}
    seeds, older = set[Any](), 0
    for path, summary in _summaries(folder):
        whole = summary.get("correction") and not summary.get("perfect_perception") and not summary.get("ablation")
        if not whole or not summary.get("looks") or "hand" not in summary:
            continue
        if "nominal_X_hand_ee" not in summary:
            older += 1
            continue
        seed = summary.get("seed", path)
        if summary["nominal_X_hand_ee"] is None or seed in seeds:  # a tool of which nobody knew the face has none
            continue
        seeds.add(seed)
        try:
            X_hand_ee = np.array(summary["looks"][0]["X_hand_ee"], dtype=float)
            shift = X_hand_ee @ inverse(np.array(summary["nominal_X_hand_ee"], dtype=float))
        except (ValueError, KeyError, TypeError) as error:
            raise UserError(f"cannot read {path}: {words_of(error)}", code="user.unreadable_run") from error
        found.setdefault(str(summary["hand"]), []).append(shift)
    learnt = {hand: _mean(np.stack(shifts)) for hand, shifts in found.items() if len(shifts) >= LEAST_JOBS}
    if not learnt:
        counts = ", ".join(f"{len(shifts)} with the hand {hand}" for hand, shifts in found.items()) or "none"
        old = f" ({older} more are of a version that did not record the nominal grasp)" if older else ""
        raise UserError(
            f"{folder}: a mean takes {LEAST_JOBS} jobs of the whole system with one hand, each of another seed, and "
            f"there are {counts}{old}: give the folder of a plan's trials with the arm `full`",
            code="user.too_few_runs",
        )
    return learnt


def learn_shift(folder: Path, hand: str) -> LearntShift:
    """The mean for one hand.

    Args:
        folder: As of `learn_shifts`.
        hand: Model of the hand.

    Returns:
        The mean.

    Raises:
        UserError: As of `learn_shifts`; or there are too few jobs with this hand (`user.too_few_runs`).
    """
    learnt = learn_shifts(folder)
    if hand not in learnt:
        raise UserError(
            f"{folder}: there are {LEAST_JOBS} jobs or more with {', '.join(learnt)}, and not with the hand {hand}: "
            "give the folder of trials with the same hand",
            code="user.too_few_runs",
        )
    return learnt[hand]


def _summaries(folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """The summaries of finished runs, with their paths."""
    for path in sorted(folder.rglob("summary.json")):
        if any(part.startswith(".") for part in path.relative_to(folder).parts):
            continue  # a run that has not ended
        try:
            summary = json.loads(path.read_text())
        except (OSError, ValueError) as error:
            raise UserError(f"cannot read {path}: {words_of(error)}", code="user.unreadable_run") from error
        if isinstance(summary, dict):
            yield str(path), summary


def _mean(Xs: Array) -> LearntShift:
    turns = Rotation.from_matrix(Xs[:, :3, :3])
    mean = transform(turns.mean().as_matrix(), Xs[:, :3, 3].mean(axis=0))
    away = np.linalg.norm(Xs[:, :3, 3] - mean[:3, 3], axis=1)
    turned = (turns.mean().inv() * turns).magnitude()
    return LearntShift(mean, len(Xs), (float(np.sqrt(np.mean(away**2))), float(np.sqrt(np.mean(turned**2)))))
