"""The weights beside their calibration: `pose.safetensors` (float16) and `pose.json`."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from toolee_robot.errors import AssetError
from toolee_robot.perception.pose.confidence import FEATURES, ConfidenceModel
from toolee_robot.perception.pose.network import NetworkConfig, PoseNet
from toolee_robot.perception.pose.pooling import SigmaScale
from toolee_robot.types import Category

WEIGHTS = "pose.safetensors"
CARD = "pose.json"
DEFAULT_FOLDER = Path(__file__).parent.parent / "weights"

_UNFITTED = ConfidenceModel((0.0,) * len(FEATURES), (1.0,) * len(FEATURES), (0.0,) * len(FEATURES), -1.0)


@dataclass(frozen=True)
class Calibration:
    """What is fitted on held-out tools after the training: factors on sigma per category, and the confidence.

    The defaults, before any fit, trust nothing."""

    scales: dict[Category, SigmaScale] = field(default_factory=lambda: dict.fromkeys(Category, SigmaScale()))
    confidence: ConfidenceModel = _UNFITTED


def save(folder: Path, net: PoseNet, calibration: Calibration, report: dict[str, Any]) -> None:
    """Write both files, each in one step. report: free-form record of the training, its settings and metrics."""
    folder.mkdir(parents=True, exist_ok=True)
    # torch.compile's wrapper and DDP prefix names; the caller passes the bare module.
    tensors = {k: v.detach().half().cpu().contiguous() for k, v in net.state_dict().items()}
    part = folder / (WEIGHTS + ".part")
    save_file(tensors, part)
    part.replace(folder / WEIGHTS)
    card = {
        "network": net.config.to_dict(),
        "sigma_scale": {c.value: {"position": s.position, "angle": s.angle} for c, s in calibration.scales.items()},
        "confidence": calibration.confidence.to_dict(),
        "report": report,
    }
    part = folder / (CARD + ".part")
    part.write_text(json.dumps(card, indent=1) + "\n")
    part.replace(folder / CARD)


def load(folder: Path | None = None) -> tuple[PoseNet, Calibration]:
    """The network (float32, eval mode, CPU) and its calibration. Raises AssetError if missing or unreadable."""
    folder = folder or DEFAULT_FOLDER
    missing = [name for name in (WEIGHTS, CARD) if not (folder / name).is_file()]
    if missing:
        raise AssetError(
            f"{' and '.join(missing)} not found in {folder}: reinstall the package, or train them with "
            "`python -m toolee_robot.perception.train_pose --out DIR`"
        )
    try:
        card = json.loads((folder / CARD).read_text())
        net = PoseNet(NetworkConfig(**card["network"]))
        net.load_state_dict({k: v.float() for k, v in load_file(folder / WEIGHTS).items()})
        scales = {Category(c): SigmaScale(**s) for c, s in card["sigma_scale"].items()}
        calibration = Calibration(scales, ConfidenceModel.from_dict(card["confidence"]))
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, SafetensorError) as error:
        raise AssetError(f"the pose weights in {folder} are unreadable: {error}") from error
    return net.requires_grad_(False).eval(), calibration


def bare(net: torch.nn.Module) -> PoseNet:
    """The PoseNet inside torch.compile's wrapper, or itself."""
    inner = getattr(net, "_orig_mod", net)
    assert isinstance(inner, PoseNet)
    return inner
