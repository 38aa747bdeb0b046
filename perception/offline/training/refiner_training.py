"""Train the refiner of the detector's masks, on one GPU, several, or (small) on a CPU.

    toolee train refinement --data data/train --out runs/refinement --minutes 15

The detector runs once on every image; its detections are the refiner's examples. Use images on which the detector was
not trained, because on its training images its masks are better than on new ones. Scenes that appear during the
training are included, so that generation may still run. The learning rate follows the clock. Every checkpoint writes
the averaged weights in half precision.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from toolee_robot.errors import UserError
from toolee_robot.perception.detection.boxes import clip
from toolee_robot.perception.detection.detector import TOOL, Detector, trained_detector
from toolee_robot.perception.detection.inputs import encode_rgbd, working_size
from toolee_robot.perception.detection.passes import MAGNIFICATION
from toolee_robot.perception.detection.refiner import (
    WEIGHTS_NAME,
    Images,
    MaskAt,
    Refiner,
    RefinerConfig,
    Squares,
    load_refiner,
    sample_squares,
)
from toolee_robot.perception.offline.dataset.records import MIN_POINTS
from toolee_robot.perception.offline.dataset.scenes import SegmentationSet
from toolee_robot.perception.offline.training.detector_training import mask_overlap, outline_losses, weighted_mean
from toolee_robot.perception.offline.training.image_training import (
    DeviceStore,
    ImageTraining,
    ImageTrainingRun,
    SceneStream,
)
from toolee_robot.perception.offline.training.images import recolour
from toolee_robot.perception.offline.training.loop import Distributed, init_distributed
from toolee_robot.perception.weight_files import load_weights

MIN_SCORE = 0.02
"""Least score of a detection that is an example: `segmenter.EVERYTHING`, what an evaluation ranks."""
MIN_LEARNT_IOU = 0.25
"""Least IoU with the true mask at which a detection's mask is learnt; of others only the quality is."""
LEARNT_SHARE = 0.75
"""Share of a batch whose masks are learnt."""
VALIDATION = 50
"""Every so many-th image is kept for validation."""
_ZOOMS = (1.0, MAGNIFICATION)
"""Half of the images are seen as large as tools are in the zoom pass: its masks are better."""
_AT_ONCE = 64


@dataclass(frozen=True)
class Detections:
    """N detections of end effectors.

    Attributes:
        image: Index of the image, (N,).
        boxes: Boxes of the detections, (N, 4) [px of the image].
        covered: Boxes of their masks, (N, 4) [px of the image].
        masks: Probability times 255, (N, MASK_SIZE, MASK_SIZE) uint8.
        category: Index of the category, (N,).
        score: In [0, 1], (N,).
        truth: Id of the EE of the same category that the detection overlaps most, 0 for none, (N,).
        counts: Whether that EE has enough visible pixels to be detected, (N,).
    """

    image: Tensor
    boxes: Tensor
    covered: Tensor
    masks: Tensor
    category: Tensor
    score: Tensor
    truth: Tensor
    counts: Tensor

    def __len__(self) -> int:
        return len(self.image)

    def of(self, which: Tensor) -> Detections:
        """The rows of an index or mask."""
        return Detections(*(getattr(self, f.name)[which] for f in fields(self)))

    @staticmethod
    def cat(several: list[Detections]) -> Detections:
        """Several records joined."""
        return Detections(*(torch.cat([getattr(each, f.name) for each in several]) for f in fields(Detections)))

    def mask_at(self) -> MaskAt:
        """A function that reads the masks at an image's pixel centres: bilinear, over 0.5."""

        def at(column: Tensor, row: Tensor) -> Tensor:
            span = (self.covered[:, 2:] - self.covered[:, :2]).clamp(min=1e-3)
            u = 2 * (column + 0.5 - self.covered[:, 0, None, None]) / span[:, 0, None, None] - 1
            v = 2 * (row + 0.5 - self.covered[:, 1, None, None]) / span[:, 1, None, None] - 1
            inside = (u.abs() <= 1) & (v.abs() <= 1)
            probability = self.masks[:, None].float() / 255
            grid = torch.stack([u, v], -1)
            values = F.grid_sample(probability, grid, padding_mode="border", align_corners=False)[:, 0]
            return (values > 0.5) & inside

        return at


@dataclass(frozen=True)
class Examples:
    """A batch of examples.

    Attributes:
        squares: (N, CHANNELS, CELLS, CELLS); see `crops.sample_squares`.
        category: Index of the category, (N,).
        score: The detector's scores, (N,).
        truth: True masks, (N, CELLS, CELLS) bool.
        learnt: Whether the mask is learnt, (N,) bool.
        counts: Whether the quality is learnt, (N,) bool.
    """

    squares: Tensor
    category: Tensor
    score: Tensor
    truth: Tensor
    learnt: Tensor
    counts: Tensor


class RefinementData:
    """A data set, or one rank's part of it, as bytes on the device, with the detector's detections in it. It may grow.

    Args:
        detector: A detector that was not trained on these images.
        device: torch device that holds the images.
        expected: See `DeviceStore`.
    """

    def __init__(self, detector: Detector, device: torch.device, expected: int = 0) -> None:
        self._detector = detector.fuse().to(device).to(memory_format=torch.channels_last)
        self._store = DeviceStore(device, tools=False, expected=expected)
        self.detections: Detections | None = None
        self.validation = self._learnt = self._judged = torch.empty(0, dtype=torch.long, device=device)

    def extend(self, more: SegmentationSet) -> None:
        """Add more images, all of one size, and run the detector on them."""
        device, first, n = self._store.device, len(self._store), len(more.rgb)
        self._store.extend(more)
        categories = torch.from_numpy(more.categories).to(device)
        found = [] if self.detections is None else [self.detections]
        for rows in torch.split(torch.arange(n, device=device), _AT_ONCE):
            zooms = zoom_of(first + rows)
            for zoom in _ZOOMS:
                some = rows[zooms == zoom]
                if len(some):
                    found.append(self._detections_in(first + some, categories[some], zoom))
        self.detections = Detections.cat(found)
        aside, learnt = is_validation(self.detections.image), self.detections.truth > 0
        self._learnt, self._judged = (torch.nonzero(rows & ~aside)[:, 0] for rows in (learnt, ~learnt))
        self.validation = torch.nonzero(aside & learnt & self.detections.counts)[:, 0]

    @property
    def ready(self) -> bool:
        """Whether there is an example to learn from."""
        return len(self._learnt) > 0

    def __len__(self) -> int:
        """Number of images."""
        return len(self._store)

    def batch(self, count: int) -> Examples:
        """Random training examples, augmented."""
        learnt = round(LEARNT_SHARE * count) if len(self._judged) else count
        picks = [
            rows[torch.randint(len(rows), (n,), device=rows.device)]
            for rows, n in ((self._learnt, learnt), (self._judged, count - learnt))
            if n
        ]
        assert self.detections is not None
        detections = self.detections.of(torch.cat(picks))
        score = torch.logit(detections.score, 1e-3)
        score = torch.sigmoid(score + 0.3 * torch.randn_like(score))
        squares = Squares.about(detections.boxes).jittered()
        examples = self._examples(detections, squares, score)
        colour = recolour(examples.squares[:, :3], 0.7)
        colour = (
            colour + 4.0 * torch.rand((len(colour), 1, 1, 1), device=colour.device) * torch.randn_like(colour)
        ).clamp(0, 255)
        return replace(examples, squares=torch.cat([colour, examples.squares[:, 3:]], 1))

    def plain(self, which: Tensor) -> Examples:
        """The detections `which` (N,) without augmentation, as at inference."""
        assert self.detections is not None
        detections = self.detections.of(which)
        return self._examples(detections, Squares.about(detections.boxes), detections.score)

    def _examples(self, detections: Detections, squares: Squares, score: Tensor) -> Examples:
        images, index = torch.unique(detections.image, return_inverse=True)
        shown = Images(self._store.rgb[images], self._store.depth(images), self._store.focal[images])
        seen, pixels = sample_squares(shown, index, squares, detections.mask_at())
        truth = (
            self._ids(detections.image, pixels)
            == torch.where(detections.truth > 0, detections.truth, 255)[:, None, None]
        )
        return Examples(seen, detections.category, score, truth, detections.truth > 0, detections.counts)

    def _ids(self, image: Tensor, pixels: Tensor) -> Tensor:
        """Ids of the EEs (N, CELLS, CELLS) at pixels (N, 2, CELLS, CELLS), 0 beyond the image."""
        column, row = pixels.clamp(min=0).unbind(1)
        return torch.where(pixels[:, 0] >= 0, self._store.maps[image[:, None, None], 0, row, column], 0)

    def _detections_in(self, image: Tensor, categories: Tensor, zoom: float) -> Detections:
        """Run the detector on images.

        Args:
            image: Their indices, (B,).
            categories: Class indices of their EEs, (B, E).
            zoom: Magnification relative to the detector's first pass.

        Returns:
            The detections, matched to the truth.
        """
        rgb = self._store.rgb[image].permute(0, 3, 1, 2).float()
        depth = self._store.depth(image)
        height, width = rgb.shape[-2:]
        size = working_size(height, width, round(self._detector.config.working_pixels * zoom**2))
        focal = self._store.focal[image] * math.sqrt(size[0] * size[1] / (height * width))
        rgb = F.interpolate(rgb, size, mode="bilinear", align_corners=False)
        depth = F.interpolate(depth[:, None], size, mode="nearest-exact")[:, 0]
        batch = encode_rgbd(rgb, depth, focal)
        batch = replace(batch, pixels=batch.pixels.contiguous(memory_format=torch.channels_last))
        device = rgb.device.type
        with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
            raw = self._detector.detect(batch, MIN_SCORE)
        scale = rgb.new_tensor([width / size[1], height / size[0]]).repeat(2)
        of = torch.cat([torch.full((len(r.boxes),), i, device=rgb.device) for i, r in enumerate(raw)])
        boxes, covered, masks, labels, score = (
            torch.cat([getattr(r, name) for r in raw]).clone()
            for name in ("boxes", "mask_boxes", "masks", "labels", "scores")
        )
        ees = labels != TOOL
        detections = Detections(
            image[of],
            clip(boxes * scale, height, width),
            covered * scale,
            (masks.float() * 255).round().to(torch.uint8),
            labels - 1,
            score.float(),
            torch.zeros_like(labels, dtype=torch.uint8),
            torch.ones_like(ees),
        ).of(ees)
        return self._matched(detections, categories[of[ees]])

    def _matched(self, detections: Detections, categories: Tensor) -> Detections:
        """Detections with `truth` and `counts`.

        Args:
            detections: The detections.
            categories: Class index of EE ids 1..E in each detection's image, (N, E).

        Returns:
            The detections with both fields.
        """
        if not len(detections):
            return detections
        zero = torch.zeros(len(detections), dtype=torch.long, device=detections.image.device)
        blank = torch.zeros((1, *self._store.maps.shape[2:]), device=zero.device)
        images = Images(blank[..., None].expand(-1, -1, -1, 3), blank, zero[:1] + 1.0)
        seen, pixels = sample_squares(images, zero, Squares.about(detections.boxes), detections.mask_at())
        mask, ids = seen[:, -1] > 0, self._ids(detections.image, pixels)
        ious = []
        for ee in range(1, categories.shape[1] + 1):
            there = (ids == ee) & (categories[:, ee - 1] == detections.category + 1)[:, None, None]
            ious.append((there & mask).sum((1, 2)) / (there | mask).sum((1, 2)).clamp(min=1))
        best, which = torch.stack(ious, 1).max(1)
        truth = torch.where(best >= MIN_LEARNT_IOU, which + 1, 0).to(torch.uint8)
        shown = (self._store.maps[detections.image, 0] == truth[:, None, None]).sum((1, 2))
        return replace(detections, truth=truth, counts=(truth == 0) | (shown >= MIN_POINTS))


def zoom_of(image: Tensor) -> Tensor:
    """Magnification at which the detector sees images (N,).

    Two of each in turn, so that the validation images have both.
    """
    return image.new_tensor(_ZOOMS, dtype=torch.float64)[image // 2 % len(_ZOOMS)]


def is_validation(image: Tensor) -> Tensor:
    """Which of the images (N,) are kept for validation."""
    return image % VALIDATION == 0


CHECKPOINT = "refinement_checkpoint.pt"
LOSSES = ("mask", "dice", "quality")
_VALIDATED = 2048
_JUDGED_AT_ONCE = 256


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
    name = WEIGHTS_NAME
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
        for part in torch.split(chosen, _JUDGED_AT_ONCE) if len(chosen) else ():
            examples = self.data.plain(part)
            for name, value in losses(*self._forward(refiner, examples), examples).items():
                sums[name] = sums.get(name, 0.0) + float(value) * len(part) / len(chosen)
        return sums

    def described(self) -> dict[str, Any]:
        validation = self.validate()
        self.record({"event": "validation", **validation})
        return {"kind": "mask_refiner", "model": self.config.model.to_json(), "validation": validation}
