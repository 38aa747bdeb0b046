"""Train the detector from scratch within a budget of minutes, on one GPU, several, or (small) on a CPU.

    toolee train segmentation --data data/train --out runs/segmentation --minutes 12

The whole data set is held on the device as bytes (each rank its share); scenes that appear during the training are
included, so that generation may still run. Targets and augmentation are computed on the device. The learning rate
follows the clock: a run ends annealed whatever the machine's speed. Every checkpoint writes the averaged weights in
half precision.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from toolee_robot.errors import UserError
from toolee_robot.perception.detection.config import DetectorConfig, working_size
from toolee_robot.perception.detection.detector import CLASSES, Detector
from toolee_robot.perception.detection.detector_weights import WEIGHTS_NAME, load_detector
from toolee_robot.perception.offline.dataset.spec import refuse_test_set
from toolee_robot.perception.offline.detection.backgrounds import Backgrounds
from toolee_robot.perception.offline.detection.images import DeviceImages, augment
from toolee_robot.perception.offline.detection.losses import DetectorLoss, instances_from_maps
from toolee_robot.perception.offline.training.distributed import Distributed, init_distributed
from toolee_robot.perception.offline.training.image_training import ImageTraining, ImageTrainingRun
from toolee_robot.perception.offline.training.labelled_images import SegmentationImages
from toolee_robot.perception.offline.training.scene_stream import SceneStream
from toolee_robot.perception.weight_files import load_weights


@dataclass(frozen=True)
class SegmentationTraining(ImageTraining):
    """A training of the detector. The budget excludes the loading of the data.

    Attributes:
        augmentation: Strength of the augmentation; 0: none, 1: full.
        wide: Share of images with a wide range of apparent sizes; above 0, all images also get bright and plain tools,
            worn ones with stickers, and the effects of light, cameras and depth sensors (`augment`).
        backgrounds: Folder of photographs without tools, put behind, beside and on the rendered ones; None: none.
        init_share: Share of the initial weights in the exported ones, 0 to 1.
        model: Architecture of the detector.
    """

    augmentation: float = 1.0
    wide: float = 0.0
    backgrounds: Path | None = None
    init_share: float = 0.0
    model: DetectorConfig = field(default_factory=DetectorConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (0 <= self.wide <= 1 and 0 <= self.init_share < 1):
            raise UserError("wide must be 0 to 1, init_share 0 to under 1", code="user.training_options")
        if self.backgrounds is not None and self.wide == 0:
            raise UserError("backgrounds are used with wide above 0: give --wide 0.5", code="user.training_options")
        if self.init_share and self.init is None:
            raise UserError("init_share: say whose share that is, with --init FOLDER", code="user.init_share")
        if self.backgrounds is not None:
            refuse_test_set(self.backgrounds)

    def to_json(self) -> dict[str, Any]:
        """See `ImageTraining`."""
        folder = self.backgrounds
        return {**super().to_json(), "backgrounds": None if folder is None else folder.name}


def train(config: SegmentationTraining, images: SegmentationImages | None = None) -> Path:
    """Run the training.

    Args:
        config: Its settings.
        images: The data; None: read from `config.data`.

    Returns:
        The folder with the exported weights, their description and the log.

    Raises:
        UserError: There is no scene to train on.
        TooleeError: A loss is not finite.
    """
    with init_distributed(config.device) as distributed:
        torch.manual_seed(config.seed + 1000 * distributed.rank)
        torch.backends.cudnn.benchmark = True
        stream = SceneStream(config.data, (distributed.rank, distributed.world)) if images is None else None
        try:
            first = [images] if images is not None else stream.take(config.patience) if stream else []
            if not first:
                raise UserError(
                    f"{config.data} holds no scene for rank {distributed.rank}: generate the data set first",
                    code="user.data_empty",
                )
            _Run(config, distributed, first, stream).loop()
        finally:
            if stream is not None:
                stream.close()
    return config.out


class _Run(ImageTrainingRun):
    config: SegmentationTraining
    name = WEIGHTS_NAME

    def __init__(
        self,
        config: SegmentationTraining,
        distributed: Distributed,
        first: list[SegmentationImages],
        stream: SceneStream | None,
    ) -> None:
        self.config, self.stream = config, stream
        self.data = DeviceImages(first[0], distributed.device, 0 if stream is None else stream.expected)
        self._extend(first[1:])
        detector = Detector(config.model)
        if config.init is not None:
            load_detector(detector, *load_weights(config.init, WEIGHTS_NAME))
        self._initial = {}
        if config.init_share > 0:
            self._initial = {k: v.clone() for k, v in detector.state_dict().items() if v.is_floating_point()}
        detector = detector.to(distributed.device).to(memory_format=torch.channels_last)
        loss = DetectorLoss(detector)
        self.augment = augment
        self.backgrounds = None
        if config.backgrounds is not None:
            self.backgrounds = Backgrounds(config.backgrounds, distributed.device)
        if config.compile and distributed.device.type == "cuda":
            # About 10 % faster. The targets are not compiled: compiled, argmax takes the last of equal values instead
            # of the first, which gives wrong boxes.
            detector.backbone.compile(dynamic=False)
            loss.compile_proposal_losses()
            if config.wide == 0:
                self.augment = torch.compile(augment, dynamic=False)
        super().__init__(config, config.out, distributed, detector, loss)

    def images(self) -> int:
        return len(self.data)

    def extend(self) -> None:
        self._extend(self.stream.take() if self.stream is not None else [])

    def _extend(self, images: list[SegmentationImages]) -> None:
        for more in images:
            self.data.extend(more)

    def described(self) -> dict[str, Any]:
        return {"kind": "mask_rcnn_resnet18_fpn", "classes": list(CLASSES), "model": self.config.model.to_json()}

    def averaged(self) -> dict[str, Tensor]:
        """See `TrainingRun`: with a share of the initial weights, for what these knew (Wortsman et al. 2022)."""
        found, share = super().averaged(), self.config.init_share
        known = {k: v.to(self.distributed.device) for k, v in self._initial.items() if k in found}
        return {**found, **{k: torch.lerp(found[k], v, share) for k, v in known.items()}}

    def losses(self) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        config, device = self.config, self.distributed.device
        sample = self.data.sample(config.batch)
        size = working_size(sample.rgb.shape[1], sample.rgb.shape[2], config.model.working_pixels)
        batch, maps = self.augment(sample, size, config.augmentation, config.wide, self.backgrounds)
        instances = instances_from_maps(maps, sample.categories, self.data.tools)
        pixels = batch.pixels.contiguous(memory_format=torch.channels_last)
        with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
            losses: dict[str, Tensor] = self.module(replace(batch, pixels=pixels), instances)
        return losses, {}
