"""Train the detector from scratch within a budget of minutes, on one GPU, several, or (small) on a CPU.

    toolee train segmentation --data data/train --out runs/segmentation --minutes 12

The whole data set is held on the device as bytes (each rank its share); scenes that appear during the training are
included, so that generation may still run. Targets and augmentation are computed on the device. The learning rate
follows the clock: a run ends annealed whatever the machine's speed. Every checkpoint writes the averaged weights in
half precision.

InstanceTargets come as id maps: in `InstanceTargets.maps[:, 0]` a pixel holds the id of the end effector seen there, in
`maps[:, 1]` that of the tool (0: none). Ids start at 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from toolee_robot.errors import UserError
from toolee_robot.perception.detection.backbone import MASK_SIZE, mask_boxes
from toolee_robot.perception.detection.boxes import encode, pairwise_iou
from toolee_robot.perception.detection.detector import (
    CLASSES,
    ROI_DELTA_WEIGHTS,
    TOOL,
    WEIGHTS_NAME,
    Detector,
    load_detector,
)
from toolee_robot.perception.detection.inputs import DetectorConfig, RgbdBatch, working_size
from toolee_robot.perception.offline.dataset.scenes import SegmentationSet
from toolee_robot.perception.offline.dataset.spec import refuse_test_set
from toolee_robot.perception.offline.training.backgrounds import Backgrounds
from toolee_robot.perception.offline.training.image_training import (
    ImageTraining,
    ImageTrainingRun,
    SceneStream,
)
from toolee_robot.perception.offline.training.images import DeviceImages, augment
from toolee_robot.perception.offline.training.loop import Distributed, init_distributed
from toolee_robot.perception.weight_files import load_weights

EE_PIXELS, TOOL_PIXELS = 45, 90
"""InstanceTargets with fewer visible pixels [px of the network's input], EEs and tools, are ignored: neither target nor
background.
"""
ROIS_PER_IMAGE, POSITIVE_ROIS = 64, 20
RPN_SAMPLES, RPN_POSITIVES = 256, 96


@dataclass(frozen=True)
class InstanceTargets:
    """Targets of a batch, padded to G instances per image.

    Attributes:
        boxes: (B, G, 4) [px].
        labels: Class indices 1..5, 0 for padding, (B, G).
        ignored: Too little is visible: neither target nor background, (B, G) bool.
        maps: Id maps (B, 2, H, W) uint8: EEs, then tools.
        plane: Which of the two maps holds the instance, (B, G).
        ids: Its id there, (B, G): its pixels are `maps[b, plane] == ids`.
    """

    boxes: Tensor
    labels: Tensor
    ignored: Tensor
    maps: Tensor
    plane: Tensor
    ids: Tensor


def instances_from_maps(maps: Tensor, categories: Tensor, tools: int) -> InstanceTargets:
    """Targets from id maps.

    Args:
        maps: (B, 2, H, W): ids of EEs, then of tools.
        categories: Class index of EE ids 1..E, 0 where there is no such EE, (B, E).
        tools: Largest id of a tool.

    Returns:
        The targets.
    """
    n, _, height, width = maps.shape
    ees = categories.shape[1]
    device = maps.device
    id_list = [*range(1, ees + 1), *range(1, tools + 1)]
    plane_list = [0] * ees + [1] * tools
    counts, boxes = [], []
    for i, p in zip(id_list, plane_list, strict=True):
        seen = maps[:, p] == i
        columns, rows = seen.any(1), seen.any(2)
        counts.append(seen.sum((1, 2)))
        x0, y0 = columns.byte().argmax(1), rows.byte().argmax(1)
        x1, y1 = width - columns.flip(1).byte().argmax(1), height - rows.flip(1).byte().argmax(1)
        boxes.append(torch.stack([x0, y0, x1, y1], 1).float())
    count = torch.stack(counts, 1)
    labels = torch.cat([categories.long(), torch.full((n, tools), TOOL, device=device)], 1)
    labels = torch.where(count > 0, labels, 0)
    ids, plane = torch.tensor(id_list, device=device), torch.tensor(plane_list, device=device)
    least = torch.where(plane == 0, EE_PIXELS, TOOL_PIXELS)
    box = torch.stack(boxes, 1) * (labels > 0)[..., None]
    ids, plane = ids.expand(n, -1), plane.expand(n, -1)
    return InstanceTargets(box, labels, (labels > 0) & (count < least), maps, plane, ids)


class DetectorLoss(nn.Module):
    """The detector with its losses: `forward` is one training step's graph, so that DDP can wrap it.

    Args:
        detector: The network that is trained.
    """

    def __init__(self, detector: Detector) -> None:
        super().__init__()
        self.detector = detector
        self._rpn_losses = _rpn_losses

    def compile_proposal_losses(self) -> None:
        """Compile the proposal losses for the GPU: they run over all anchors of all images."""
        self._rpn_losses = torch.compile(_rpn_losses, dynamic=False)

    def forward(self, batch: RgbdBatch, instances: InstanceTargets) -> dict[str, Tensor]:
        """The losses of a batch.

        Args:
            batch: The images.
            instances: Their targets.

        Returns:
            Scalars by name: "objectness", "proposal", "class", "box", "mask", "dice", "quality".
        """
        detector = self.detector
        height, width = batch.pixels.shape[-2:]
        pyramid = detector.backbone(batch.pixels)
        scores, deltas = detector.rpn(pyramid)
        anchors = torch.cat(detector.anchors(height, width, batch.pixels.device))
        losses = self._rpn_losses(torch.cat(scores, 1).float(), torch.cat(deltas, 1).float(), anchors, instances)
        boxes, valid = detector.proposals(scores, deltas, height, width, 200, 200)
        rois = _sample_rois(boxes, valid, instances, height, width)
        flat = torch.cat([rois.image, rois.boxes], 1)
        logits, box_deltas = detector.box_outputs(pyramid, flat)
        losses["class"] = weighted_mean(F.cross_entropy(logits.float(), rois.labels, reduction="none"), rois.used)
        chosen = box_deltas[torch.arange(len(flat), device=flat.device), rois.labels].float()
        error = F.smooth_l1_loss(
            chosen, encode(rois.targets, rois.boxes, ROI_DELTA_WEIGHTS), beta=0.5, reduction="none"
        ).sum(1)
        losses["box"] = (error * rois.positive).sum() / rois.used.sum().clamp(min=1)
        pick = rois.mask_index
        logits, quality = detector.mask_outputs(pyramid, batch, flat[pick], rois.labels[pick])
        truth = _mask_targets(instances, flat[pick], rois.instance[pick])
        positive = rois.positive[pick]
        losses |= {name: weighted_mean(value, positive) for name, value in _mask_losses(logits, quality, truth).items()}
        return losses


@dataclass(frozen=True)
class _Rois:
    """R = B * ROIS_PER_IMAGE sampled regions.

    Attributes:
        image: Image index, (R, 1).
        boxes: (R, 4) [px].
        labels: Class index, 0 for background, (R,).
        targets: True boxes, (R, 4) [px].
        instance: Index of the matched instance, (R,).
        used: 1 where the region counts, (R,).
        positive: 1 where it shows an instance, (R,).
        mask_index: Rows of the positives' places, (B * POSITIVE_ROIS,).
    """

    image: Tensor
    boxes: Tensor
    labels: Tensor
    targets: Tensor
    instance: Tensor
    used: Tensor
    positive: Tensor
    mask_index: Tensor


def _rpn_losses(scores: Tensor, deltas: Tensor, anchors: Tensor, instances: InstanceTargets) -> dict[str, Tensor]:
    with torch.no_grad():
        present, ignored = instances.labels > 0, instances.ignored
        iou = pairwise_iou(anchors[None], instances.boxes) * present[:, None]
        best, match = iou.max(2)
        # Every instance keeps its best anchors, whatever their IoU.
        top = iou.max(1, keepdim=True)[0]
        forced = ((iou >= top - 1e-4) & (top > 0.1)).any(2)
        skip = torch.gather(ignored, 1, match) & (best > 0.3)
        positive = ((best >= 0.6) | forced) & ~skip
        negative = (best < 0.3) & ~positive & ~skip
        noise = torch.rand_like(best)
        p = torch.where(positive, noise, -1.0).topk(RPN_POSITIVES, dim=1)
        n = torch.where(negative, noise, -1.0).topk(RPN_SAMPLES - RPN_POSITIVES, dim=1)
        index = torch.cat([p.indices, n.indices], 1)
        used = torch.cat([p.values, n.values], 1) >= 0
        is_positive = used.clone()
        is_positive[:, RPN_POSITIVES:] = False
        truth = torch.gather(instances.boxes, 1, torch.gather(match, 1, index)[..., None].expand(-1, -1, 4))
        target = encode(truth, anchors[index])
    score = torch.gather(scores, 1, index)
    delta = torch.gather(deltas, 1, index[..., None].expand(-1, -1, 4))
    error = F.smooth_l1_loss(delta, target, beta=1 / 9, reduction="none").sum(-1)
    return {
        "objectness": weighted_mean(
            F.binary_cross_entropy_with_logits(score, is_positive.float(), reduction="none"), used
        ),
        "proposal": (torch.where(is_positive, error, 0.0)).sum() / used.sum().clamp(min=1),
    }


@torch.no_grad()
def _sample_rois(boxes: Tensor, valid: Tensor, instances: InstanceTargets, height: int, width: int) -> _Rois:
    """Sample a fixed number of regions per image from the proposals, the true boxes and jittered copies of them."""
    n, device = len(boxes), boxes.device
    truth = instances.boxes
    present = (instances.labels > 0) & ~instances.ignored
    size = (truth[..., 2:] - truth[..., :2]).repeat(1, 1, 2)
    # The head must learn from well placed regions while the proposals are still poor.
    jittered = [truth + size * torch.randn_like(truth) * s for s in (0.0, 0.06, 0.1, 0.15)]
    boxes = torch.cat([boxes, *jittered], 1)
    boxes = torch.minimum(boxes.clamp(min=0.0), boxes.new_tensor([width, height, width, height]))
    valid = torch.cat([valid, *([present] * len(jittered))], 1)
    valid &= ((boxes[..., 2:] - boxes[..., :2]) >= 2.0).all(-1)
    iou = pairwise_iou(boxes, truth) * (instances.labels > 0)[:, None]
    best, match = iou.max(2)
    skip = torch.gather(instances.ignored, 1, match) & (best > 0.3)
    positive = valid & (best >= 0.5) & ~skip
    negative = valid & (best < 0.5) & ~skip
    noise = torch.rand_like(best)
    p = torch.where(positive, noise, -1.0).topk(POSITIVE_ROIS, dim=1)
    q = torch.where(negative, noise, -1.0).topk(ROIS_PER_IMAGE - POSITIVE_ROIS, dim=1)
    index = torch.cat([p.indices, q.indices], 1)
    used = torch.cat([p.values, q.values], 1) >= 0
    is_positive = used.clone()
    is_positive[:, POSITIVE_ROIS:] = False
    instance = torch.gather(match, 1, index)
    labels = torch.where(is_positive, torch.gather(instances.labels, 1, instance), 0)
    image = torch.arange(n, device=device, dtype=torch.float32)[:, None].expand(-1, ROIS_PER_IMAGE)
    start = torch.arange(n, device=device)[:, None] * ROIS_PER_IMAGE
    return _Rois(
        image=image.reshape(-1, 1),
        boxes=torch.gather(boxes, 1, index[..., None].expand(-1, -1, 4)).reshape(-1, 4),
        labels=labels.reshape(-1),
        targets=torch.gather(truth, 1, instance[..., None].expand(-1, -1, 4)).reshape(-1, 4),
        instance=instance.reshape(-1),
        used=used.reshape(-1).float(),
        positive=is_positive.reshape(-1).float(),
        mask_index=(start + torch.arange(POSITIVE_ROIS, device=device)).reshape(-1),
    )


def outline_losses(logits: Tensor, truth: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Losses of masks.

    Args:
        logits: (R, S, S).
        truth: True coverage in [0, 1], (R, S, S).

    Returns:
        Cross entropy (R,), 1 - Dice coefficient (R,), and the IoU (R,) without gradient.
    """
    bce = F.binary_cross_entropy_with_logits(logits, truth, reduction="none").mean((1, 2))
    p = logits.sigmoid()
    dice = 1 - (2 * (p * truth).sum((1, 2)) + 1) / (p.sum((1, 2)) + truth.sum((1, 2)) + 1)
    with torch.no_grad():
        iou = mask_overlap(logits > 0, truth > 0.5)
    return bce, dice, iou


def mask_overlap(a: Tensor, b: Tensor) -> Tensor:
    """Intersection over union of pairs of masks.

    Args:
        a: Masks, (R, S, S) bool.
        b: The masks to compare them with, (R, S, S) bool.

    Returns:
        Intersection over union in [0, 1], (R,); 0 where both are empty.
    """
    return (a & b).sum((1, 2)) / (a | b).sum((1, 2)).clamp(min=1)


def _mask_losses(logits: Tensor, quality: Tensor, truth: Tensor) -> dict[str, Tensor]:
    """Losses of masks (R, S, S) with their predicted quality (R,).

    Cross entropy; Dice, in which small instances weigh as much as large ones; and cross entropy of the predicted IoU
    with the actual one.
    """
    bce, dice, iou = outline_losses(logits, truth)
    expected = F.binary_cross_entropy_with_logits(quality, iou, reduction="none")
    return {"mask": bce, "dice": 0.5 * dice, "quality": 0.2 * expected}


@torch.no_grad()
def _mask_targets(instances: InstanceTargets, rois: Tensor, instance: Tensor, sub: int = 2) -> Tensor:
    """Coverage of the cells of the `mask_boxes` of rois (R, 5) by `instance` (R,), read from the maps."""
    image, boxes = rois[:, 0].long(), mask_boxes(rois[:, 1:])
    plane, ids = instances.plane[image, instance], instances.ids[image, instance]
    height, width = instances.maps.shape[-2:]
    steps = (torch.arange(MASK_SIZE * sub, device=rois.device) + 0.5) / (MASK_SIZE * sub)
    x = (boxes[:, 0, None] + steps * (boxes[:, 2] - boxes[:, 0])[:, None]).floor().long()
    y = (boxes[:, 1, None] + steps * (boxes[:, 3] - boxes[:, 1])[:, None]).floor().long()
    inside = ((x >= 0) & (x < width))[:, None, :] & ((y >= 0) & (y < height))[:, :, None]
    x, y = x.clamp(0, width - 1), y.clamp(0, height - 1)
    values = instances.maps[image[:, None, None], plane[:, None, None], y[:, :, None], x[:, None, :]]
    hit = ((values == ids[:, None, None]) & inside).float()
    return F.avg_pool2d(hit[:, None], sub)[:, 0]


def weighted_mean(values: Tensor, weights: Tensor) -> Tensor:
    """Weighted mean.

    Args:
        values: Values, (R,).
        weights: Their weights, (R,), of any type.

    Returns:
        The mean, a scalar; 0 if all weights are 0.
    """
    weights = weights.float()
    return (values * weights).sum() / weights.sum().clamp(min=1)


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


def train(config: SegmentationTraining, images: SegmentationSet | None = None) -> Path:
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
        first: list[SegmentationSet],
        stream: SceneStream | None,
    ) -> None:
        self.config, self.stream = config, stream
        self.data = DeviceImages(first[0], distributed.device, 0 if stream is None else stream.expected)
        self._extend(first[1:])
        detector = Detector(config.model)
        if config.init is not None:
            load_detector(detector, *load_weights(config.init, WEIGHTS_NAME))
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
        self.start_share = config.init_share
        if config.init_share > 0:
            self.start = {k: v.clone() for k, v in self.average.items()}

    def images(self) -> int:
        return len(self.data)

    def extend(self) -> None:
        self._extend(self.stream.take() if self.stream is not None else [])

    def _extend(self, images: list[SegmentationSet]) -> None:
        for more in images:
            self.data.extend(more)

    def described(self) -> dict[str, Any]:
        return {"kind": "mask_rcnn_resnet18_fpn", "classes": list(CLASSES), "model": self.config.model.to_json()}

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
