"""How a hand moves a tool as its fingers close: the mean over earlier jobs, for jobs that only know that."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

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


def learn_shift(folder: Path, hand: str) -> LearntShift:
    """Average the first looks of earlier jobs, each against its nominal grasp.

    Args:
        folder: Folder whose runs are read, at any depth: a plan's trials, or several.
        hand: Model of the hand; runs with another one are left out.

    Returns:
        The mean.

    Raises:
        UserError: There are under `LEAST_JOBS` such runs (`user.too_few_runs`), or one cannot be read
            (`user.unreadable_run`).
    """
    shifts = []
    for path in sorted(folder.rglob("summary.json")):
        try:
            summary = json.loads(path.read_text())
            if summary.get("hand") == hand and summary.get("looks") and "nominal_X_hand_ee" in summary:
                X_hand_ee = np.array(summary["looks"][0]["X_hand_ee"], dtype=float)
                shifts.append(X_hand_ee @ inverse(np.array(summary["nominal_X_hand_ee"], dtype=float)))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UserError(f"cannot read {path}: {words_of(error)}", code="user.unreadable_run") from error
    if len(shifts) < LEAST_JOBS:
        raise UserError(
            f"{folder} has {len(shifts)} runs with a look at a tool in the hand {hand}, and a mean takes {LEAST_JOBS}: "
            "give the folder of a plan's trials with the same hand",
            code="user.too_few_runs",
        )
    Xs = np.stack(shifts)
    turns = Rotation.from_matrix(Xs[:, :3, :3])
    mean = transform(turns.mean().as_matrix(), Xs[:, :3, 3].mean(axis=0))
    away = np.linalg.norm(Xs[:, :3, 3] - mean[:3, 3], axis=1)
    turned = (turns.mean().inv() * turns).magnitude()
    return LearntShift(mean, len(Xs), (float(np.sqrt(np.mean(away**2))), float(np.sqrt(np.mean(turned**2)))))
