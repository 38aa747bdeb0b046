"""Weights (float16) and calibration of the pose network; see `toolee_robot.perception.weight_files`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from toolee_robot.end_effectors import Category
from toolee_robot.errors import AssetError
from toolee_robot.perception import weight_files
from toolee_robot.perception.pose.confidence import FEATURES, ConfidenceModel
from toolee_robot.perception.pose.network import NetworkConfig, PoseNet
from toolee_robot.perception.pose.pooling import SigmaScale

NAME = "pose"

_UNFITTED = ConfidenceModel((0.0,) * len(FEATURES), (1.0,) * len(FEATURES), (0.0,) * len(FEATURES), -1.0)


@dataclass(frozen=True)
class Calibration:
    """Calibration on held-out tools after the training. The defaults, before any fit, make every pose unusable.

    Attributes:
        scales: Factors on the pooled sigmas, per category.
        confidence: The confidence model.
    """

    scales: dict[Category, SigmaScale] = field(default_factory=lambda: dict.fromkeys(Category, SigmaScale()))
    confidence: ConfidenceModel = _UNFITTED


def save(folder: Path, net: PoseNet, calibration: Calibration, report: dict[str, Any]) -> None:
    """Write weights and description.

    Args:
        folder: Output folder.
        net: The trained network.
        calibration: Fitted on held-out tools.
        report: Record of the training: its settings and metrics.
    """
    card = {
        "network": net.config.to_dict(),
        "sigma_scale": {c.value: {"position": s.position, "angle": s.angle} for c, s in calibration.scales.items()},
        "confidence": calibration.confidence.to_dict(),
        "report": report,
    }
    weight_files.save_weights(folder, NAME, net.state_dict(), card)


def load(folder: Path | None = None) -> tuple[PoseNet, Calibration]:
    """Read the network and its calibration.

    Args:
        folder: Folder of weights; None: the shipped ones.

    Returns:
        The network (float32, eval mode, CPU) and its calibration.

    Raises:
        AssetError: The files are missing or unreadable.
    """
    tensors, card = weight_files.load_weights(folder, NAME)
    try:
        net = PoseNet(NetworkConfig(**card["network"]))
        net.load_state_dict(tensors)
        scales = {Category(c): SigmaScale(**s) for c, s in card["sigma_scale"].items()}
        calibration = Calibration(scales, ConfidenceModel.from_dict(card["confidence"]))
    except (ValueError, KeyError, TypeError, RuntimeError) as error:
        raise AssetError(
            f"the pose weights in {folder or weight_files.WEIGHTS_DIR} are unreadable: {error}", code="asset.unreadable"
        ) from error
    return net.requires_grad_(False).eval(), calibration
