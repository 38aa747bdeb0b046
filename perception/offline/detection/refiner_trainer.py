"""Train the refiner of the detector's masks, on one GPU, several, or (small) on a CPU.

    toolee train refinement --data data/train --out runs/refinement --minutes 15

The detector runs once on every image; its detections are the refiner's examples. Use images on which the detector was
not trained, because on its training images its masks are better than on new ones. Scenes that appear during the
training are included, so that generation may still run. The learning rate follows the clock. Every checkpoint writes
the averaged weights in half precision.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from toolee_robot.errors import UserError
from toolee_robot.perception.detection.detector_weights import trained_detector
from toolee_robot.perception.detection.refiner.network import WEIGHTS_NAME, Refiner, RefinerConfig, load_refiner
from toolee_robot.perception.offline.detection.losses import mask_overlap, outline_losses, weighted_mean
from toolee_robot.perception.offline.detection.refiner_data import Examples, RefinementData
from toolee_robot.perception.offline.training.distributed import Distributed, init_distributed
from toolee_robot.perception.offline.training.image_training import ImageTraining, ImageTrainingRun
from toolee_robot.perception.offline.training.scene_stream import SceneStream
from toolee_robot.perception.weight_files import load_weights

CHECKPOINT = "refinement_checkpoint.pt"
LOSSES = ("mask", "dice", "quality")
_VALIDATED = 2048
_AT_ONCE = 256


@dataclass(frozen=True, kw_only=True)
class RefinementTraining(ImageTraining):
    """A training of the refiner. The budget begins with the first scenes.

    Attributes:
        batch: Detections per step and rank, at least 2 (batch normalisation).
        lr: See `TrainingOptions`, as the next three.
        warmup_steps: Steps over which the learning rate rises.
        clip_norm: Largest norm of the gradient.
        log_every: Steps between readings of the clock and the loss.
        detector: Folder of the detector's weights; None: the shipped ones.
        model: Architecture of the refiner.
    """

    USUAL_MINUTES: ClassVar[float] = 15.0
    """Default budget [min]."""

    batch: int = 512
    lr: float = 2e-3
    warmup_steps: int = 300
    clip_norm: float = 5.0
    log_every: int = 50
    detector: Path | None = None
    model: RefinerConfig = field(default_factory=RefinerConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.batch < 2:
            raise UserError("batch must be positive and, for batch normalisation, 2 or more", code="user.batch")

    def to_json(self) -> dict[str, Any]:
        """See `ImageTraining`."""
        return {**super().to_json(), "detector": self.detector is not None}


def losses(logits: Tensor, quality: Tensor, examples: Examples) -> dict[str, Tensor]:
    """Losses of a batch.

    Args:
        logits: Mask logits (N, CELLS, CELLS).
        quality: Logits (N,) of the masks' predicted IoU.
        examples: The batch.

    Returns:
        "mask" (cross entropy) and "dice" of the masks to be learnt; "quality": cross entropy of the predicted IoU with
        the actual one, 0 for false alarms; for the log "iou": mean IoU of the masks to be learnt, and "iou_before": of
        the detector's masks.
    """
    learnt = examples.learnt.float()
    bce, dice, iou = outline_losses(logits, examples.truth.float())
    iou = iou * learnt
    with torch.no_grad():
        before = mask_overlap(examples.squares[:, -1] > 0, examples.truth)
    expected = F.binary_cross_entropy_with_logits(quality, iou, reduction="none")
    return {
        "mask": weighted_mean(bce, learnt),
        "dice": weighted_mean(0.5 * dice, learnt),
        "quality": weighted_mean(0.3 * expected, examples.counts),
        "iou": weighted_mean(iou, learnt),
        "iou_before": weighted_mean(before, learnt),
    }


def train(config: RefinementTraining) -> Path:
    """Run the training.

    Args:
        config: Its settings.

    Returns:
        The folder with the exported weights, their description and the log.

    Raises:
        AssetError: Data or weights are missing or damaged.
        UserError: A setting is unusable.
        TooleeError: The loss is not finite; the last checkpoint is kept.
    """
    with init_distributed(config.device) as distributed:
        torch.manual_seed(config.seed + 1000 * distributed.rank)
        stream = SceneStream(config.data, (distributed.rank, distributed.world))
        try:
            _Run(config, distributed, stream).loop()
        finally:
            stream.close()
    return config.out


class _Run(ImageTrainingRun):
    config: RefinementTraining
    name = tag = WEIGHTS_NAME
    checkpoint, log_name = CHECKPOINT, "refinement_log.jsonl"

    def __init__(self, config: RefinementTraining, distributed: Distributed, stream: SceneStream) -> None:
        self.config, self.stream = config, stream
        self.data = RefinementData(trained_detector(config.detector), distributed.device, stream.expected)
        waited = time.monotonic()
        while not self.data.ready and time.monotonic() - waited < config.patience:
            self._extend(1.0)
        if not self.data.ready:
            raise UserError(
                f"the detector in {config.detector or 'the package'} finds no end effector in {config.data}: generate "
                "images there, or train the detector longer",
                code="user.data_empty",
            )
        refiner = Refiner(config.model)
        if config.init is not None:
            load_refiner(refiner, load_weights(config.init, WEIGHTS_NAME)[0])
        refiner = refiner.to(distributed.device).to(memory_format=torch.channels_last)
        if config.compile and distributed.device.type == "cuda":
            refiner.compile(dynamic=False)
        super().__init__(config, config.out, distributed, refiner, refiner)

    def images(self) -> int:
        return len(self.data)

    def extend(self) -> None:
        self._extend(0.0)

    def _extend(self, timeout: float) -> None:
        for images in self.stream.take(timeout):
            self.data.extend(images)

    def losses(self) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        examples = self.data.batch(self.config.batch)
        values = losses(*self._forward(self.module, examples), examples)
        return {k: v for k, v in values.items() if k in LOSSES}, {k: v for k, v in values.items() if k not in LOSSES}

    def _forward(self, refiner: nn.Module, examples: Examples) -> tuple[Tensor, Tensor]:
        squares, device = examples.squares.contiguous(memory_format=torch.channels_last), self.distributed.device.type
        with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
            logits, quality = refiner(squares, examples.category, examples.score)
        return logits.float(), quality.float()

    @torch.inference_mode()
    def validate(self) -> dict[str, float]:
        """Evaluate the averaged network on the validation images.

        Returns:
            Mean IoU of the masks before and after, and losses; empty where the images have no EE.
        """
        refiner = Refiner(self.config.model).to(self.distributed.device).to(memory_format=torch.channels_last)
        load_refiner(refiner, self.averaged())
        refiner.eval()
        sums: dict[str, float] = {}
        chosen = self.data.validation[:_VALIDATED]
        for part in torch.split(chosen, _AT_ONCE) if len(chosen) else ():
            examples = self.data.plain(part)
            for name, value in losses(*self._forward(refiner, examples), examples).items():
                sums[name] = sums.get(name, 0.0) + float(value) * len(part) / len(chosen)
        return sums

    def described(self) -> dict[str, Any]:
        validation = self.validate()
        self.record({"event": "validation", **validation})
        return {"kind": "mask_refiner", "model": self.config.model.to_json(), "validation": validation}
