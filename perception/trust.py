"""Trust: the probability that a detection and the pose estimated from it are both right.

A pose's own confidence only judges its cloud: a mask on something else may give a plausible cloud. The detector's
scores, of the end effector and of the tool around it, judge the mask. A small logistic regression over both, fitted by
`fit_trust` on frames with and without tools, gives the probability that detection and pose are right.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.errors import AssetError, words_of
from toolee_robot.frames import Array
from toolee_robot.perception import weight_files
from toolee_robot.perception.detection.detector import WEIGHTS_NAME as DETECTOR
from toolee_robot.perception.detection.refiner import WEIGHTS_NAME as REFINER
from toolee_robot.perception.pose import weights
from toolee_robot.perception.pose.cloud_estimator import PoseResult
from toolee_robot.perception.pose.confidence import ConfidenceModel
from toolee_robot.runtime.files import read_json

NAME = "trust"
FEATURES = (
    "pose_logit",
    "detection_logit",
    "tool_found",
    "tool_score",
    *(f"is_{category}" for category in Category),
)
"""Names of the model's inputs, in order."""
_MIN = 1e-3
"""Probabilities are clipped to [_MIN, 1 - _MIN]: no single input decides alone."""


def features(confidence: float, score: float, tool_score: float, category: Category) -> Array:
    """Input of the trust model.

    Args:
        confidence: Confidence of the pose, in [0, 1].
        score: Detector's score of the end effector, in [0, 1].
        tool_score: Detector's score of the tool around it, in [0, 1]; 0 without one.
        category: Category of the end effector.

    Returns:
        Feature vector (F,), in the order of `FEATURES`.
    """
    p = np.clip([confidence, score], _MIN, 1 - _MIN)
    is_category = (float(category == other) for other in Category)
    return np.array([*np.log(p / (1 - p)), float(tool_score > 0), tool_score, *is_category])


_N = len(FEATURES)
_ODDS = ConfidenceModel((0.0,) * _N, (1.0,) * _N, (1.0, 1.0, *(0.0,) * (_N - 2)), 0.0, 0.5, FEATURES)
"""The unfitted model: the odds of pose and detection multiplied."""


@dataclass(frozen=True)
class Trust:
    """The trust model of one detector with one pose estimator.

    Attributes:
        model: Logistic regression over `FEATURES`; the default multiplies the odds of detection and pose.
    """

    model: ConfidenceModel = _ODDS

    def judge(self, score: float, tool_score: float, result: PoseResult) -> tuple[float, bool, str]:
        """Judge a pose together with the detection that it was estimated from.

        Args:
            score: Detector's score of the end effector, in [0, 1].
            tool_score: Detector's score of its tool, in [0, 1]; 0 without one.
            result: The estimated pose.

        Returns:
            The probability that both are right, whether the pose may be acted on, and the reason why not (or "ok").
        """
        x = features(result.confidence, score, tool_score, result.category)
        probability = float(self.model.probability(x))
        if result.usable and probability < self.model.threshold:
            return probability, False, f"the detector is not sure of this {result.category.label} (score {score:.2f})"
        return probability, result.usable, result.reason

    def save(self, folder: Path, report: dict[str, Any]) -> None:
        """Write trust.json beside the weights of the detector and the pose estimator that it was fitted for.

        Args:
            folder: Folder of those weights.
            report: Figures of the fit, kept in the file for the reader.
        """
        card = {"model": self.model.to_dict(), "fitted_for": _fingerprints(folder, folder), "report": report}
        (folder / f"{NAME}.json").write_text(json.dumps(card, indent=1) + "\n")

    @classmethod
    def load(cls, pose_folder: Path | None, detector_folder: Path | None) -> Self:
        """The trust model fitted for the weights in these folders.

        Args:
            pose_folder: Folder of the pose estimator's weights; None: the shipped ones.
            detector_folder: Folder of the detector's weights; None: the shipped ones.

        Returns:
            The fitted model; the unfitted one (odds multiplied) where the folders differ or have no trust.json.

        Raises:
            AssetError: The file is damaged, or was fitted for weights that have been replaced since.
        """
        folder = pose_folder or weight_files.WEIGHTS_DIR
        path = folder / f"{NAME}.json"
        if (detector_folder or weight_files.WEIGHTS_DIR) != folder or not path.is_file():
            return cls()
        try:
            card = read_json(path)
            model, fitted_for = ConfidenceModel.from_dict(card["model"], FEATURES), card["fitted_for"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise AssetError(
                f"{path} is unreadable: fetch it again, or fit it anew ({words_of(error)})", code="asset.unreadable"
            ) from error
        if fitted_for != _fingerprints(folder, folder):
            raise AssetError(
                f"{path} was fitted for other weights than those beside it: fit it anew with `toolee train trust`",
                code="asset.weights_replaced",
            )
        return cls(model)


def _fingerprints(pose_folder: Path, detector_folder: Path) -> dict[str, str]:
    """SHA-256 of each network's training record, which is unique to a training. The refiner is optional."""
    found = {}
    for name, folder in ((weights.NAME, pose_folder), (DETECTOR, detector_folder), (REFINER, detector_folder)):
        path = folder / f"{name}.json"
        if name == REFINER and not path.is_file():
            continue
        try:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as error:
            raise AssetError(
                f"weight description {path} is missing: reinstall the package", code="asset.missing"
            ) from error
    return found
