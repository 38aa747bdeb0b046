"""Weights of the detector: the shipped ones, or those of a training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torch import Tensor

from toolee_robot.errors import AssetError
from toolee_robot.perception.detection.config import DetectorConfig
from toolee_robot.perception.detection.detector import CLASSES, Detector
from toolee_robot.perception.weight_files import load_into, load_weights

WEIGHTS_NAME = "segmentation"
"""Name of the weight files."""


def load_detector(detector: Detector, tensors: dict[str, Tensor], description: dict[str, Any]) -> None:
    """Load exported weights into a detector.

    Args:
        detector: The network, changed in place.
        tensors: The weights.
        description: Their description, with the class names.

    Raises:
        AssetError: The classes or the architecture differ.
    """
    if list(description.get("classes", [])) != list(CLASSES):
        raise AssetError(
            f"the detector knows {description.get('classes')}, not {list(CLASSES)}: train it again",
            code="asset.classes",
        )
    load_into(detector, tensors, "detector")


def trained_detector(weights_dir: Path | None) -> Detector:
    """Load a trained detector.

    Args:
        weights_dir: Folder of weights; None: the shipped ones.

    Returns:
        The detector.

    Raises:
        AssetError: A file is missing, unreadable or damaged; the message names it.
    """
    tensors, description = load_weights(weights_dir, WEIGHTS_NAME)
    try:
        detector = Detector(DetectorConfig.from_json(description["model"]))
    except (KeyError, TypeError, ValueError) as error:
        raise AssetError(
            f"the detector's description is damaged, fetch it again: {error!r}", code="asset.unreadable"
        ) from error
    load_detector(detector, tensors, description)
    return detector
