"""How far to trust a pose that was estimated under a detector's mask.

A pose's own confidence is about the cloud that it is given: a mask that shows something else may still look like a good
one. The detector's scores, of the end effector and of the tool about it, tell of the mask. A small logistic model over
both, fitted by `fit_trust` on frames with and without tools, is the probability that detection and pose are right.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.errors import AssetError
from toolee_robot.frames import Array
from toolee_robot.perception import weight_files
from toolee_robot.perception.detection.detector import WEIGHTS_NAME as DETECTOR
from toolee_robot.perception.detection.refiner.network import WEIGHTS_NAME as REFINER
from toolee_robot.perception.pose import weights
from toolee_robot.perception.pose.cloud_estimator import PoseResult
from toolee_robot.perception.pose.confidence import ConfidenceModel

NAME = "trust"
FEATURES = (
    "pose_logit",
    "detection_logit",
    "tool_found",
    "tool_score",
    *(f"is_{category}" for category in Category),
)
_MIN = 1e-3
"""Probabilities are held so far from 0 and 1: no single voice is certain."""


def features(confidence: float, score: float, tool_score: float, category: Category) -> Array:
    """The model's input (F,). confidence: the pose's; score, tool_score: the detector's."""
    p = np.clip([confidence, score], _MIN, 1 - _MIN)
    is_category = (float(category == other) for other in Category)
    return np.array([*np.log(p / (1 - p)), float(tool_score > 0), tool_score, *is_category])


_N = len(FEATURES)
_ODDS = ConfidenceModel((0.0,) * _N, (1.0,) * _N, (1.0, 1.0, *(0.0,) * (_N - 2)), 0.0, 0.5, FEATURES)
"""Where nothing was fitted: the two odds multiplied."""


@dataclass(frozen=True)
class Trust:
    """The model that is right for one detector with one pose estimator."""

    model: ConfidenceModel = _ODDS

    def judge(self, score: float, tool_score: float, result: PoseResult) -> tuple[float, bool, str]:
        """Of a pose under a detection with these scores: the probability that both are right, whether to act on it, and
        why not, or "ok"."""
        x = features(result.confidence, score, tool_score, result.category)
        probability = float(self.model.probability(x))
        if result.usable and probability < self.model.threshold:
            return probability, False, f"the detector is not sure of this {result.category} (score {score:.2f})"
        return probability, result.usable, result.reason

    def save(self, folder: Path, report: dict[str, Any]) -> None:
        """Write trust.json beside the weights of detector and pose estimator that it was fitted for. report: of the
        fit."""
        card = {"model": self.model.to_dict(), "fitted_for": _fingerprints(folder, folder), "report": report}
        (folder / f"{NAME}.json").write_text(json.dumps(card, indent=1) + "\n")

    @classmethod
    def load(cls, pose_folder: Path | None, detector_folder: Path | None) -> Self:
        """What was fitted for the weights in these folders (the shipped ones if None); the odds multiplied where
        nothing was. Raises AssetError for a file that is damaged, or that was fitted for weights which have been
        replaced."""
        folder = pose_folder or weight_files.WEIGHTS_DIR
        path = folder / f"{NAME}.json"
        if (detector_folder or weight_files.WEIGHTS_DIR) != folder or not path.is_file():
            return cls()
        try:
            card = json.loads(path.read_text())
            model, fitted_for = ConfidenceModel.from_dict(card["model"], FEATURES), card["fitted_for"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise AssetError(f"{path} is unreadable: fetch it again, or fit it anew ({error!r})") from error
        if fitted_for != _fingerprints(folder, folder):
            raise AssetError(
                f"{path} was fitted for other weights than those beside it: fit it anew with `toolee train trust`"
            )
        return cls(model)


def _fingerprints(pose_folder: Path, detector_folder: Path) -> dict[str, str]:
    """Of the records of the trainings, which no two of them share. Without a refiner masks are the detector's own."""
    found = {}
    for name, folder in ((weights.NAME, pose_folder), (DETECTOR, detector_folder), (REFINER, detector_folder)):
        path = folder / f"{name}.json"
        if name == REFINER and not path.is_file():
            continue
        try:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as error:
            raise AssetError(f"weight description {path} is missing: reinstall the package") from error
    return found
