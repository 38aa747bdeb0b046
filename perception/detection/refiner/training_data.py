"""What the refiner is trained on: images on the device, and what a detector finds in them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from toolee_robot.perception.dataset.records import MIN_POINTS
from toolee_robot.perception.detection.boxes import clip
from toolee_robot.perception.detection.detector import TOOL, Detector, working_size
from toolee_robot.perception.detection.inputs import encode_rgbd
from toolee_robot.perception.detection.refiner.crops import Images, MaskAt, Squares, look
from toolee_robot.perception.detection.training_data import recolour
from toolee_robot.perception.detection.zoom_pass import MAGNIFICATION
from toolee_robot.perception.training.labelled_images import DeviceStore, SegmentationImages

MIN_SCORE = 0.02
"""Weaker detections are no example: as `segmentation.EVERYTHING`, what an evaluation ranks."""
DRAWN = 0.25
"""A detection whose mask overlaps the truth's by this much (IoU) is drawn; others are only judged."""
DRAWN_SHARE = 0.75
"""Share of a batch's examples that are."""
VALIDATION = 50
"""Every so many-th image is kept for validation."""
_ZOOMS = (1.0, MAGNIFICATION)
"""Every second pair of images is seen as large as tools are in the zoom pass: its masks are better, and as many."""
_AT_ONCE = 64


@dataclass(frozen=True)
class Detections:
    """N detections of end effectors. image (N,); boxes (N, 4), covered (N, 4) [px of the image]: of the detection, and
    of its mask; masks (N, MASK_SIZE, MASK_SIZE) uint8: probability times 255; category (N,): index; score (N,) in
    [0, 1]; truth (N,): id of the EE that it overlaps most, of those of its category, 0 for none; counts (N,): whether
    that EE shows enough to be found."""

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
        """Some of them."""
        return Detections(*(getattr(self, f.name)[which] for f in fields(self)))

    @staticmethod
    def cat(several: list[Detections]) -> Detections:
        """All of them in one."""
        return Detections(*(torch.cat([getattr(each, f.name) for each in several]) for f in fields(Detections)))

    def mask_at(self) -> MaskAt:
        """The masks as they are in the image: bilinear at the pixels' centres, over a half."""

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
    """A batch. squares (N, CHANNELS, CELLS, CELLS); category, score (N,): as the network takes them; truth (N, CELLS,
    CELLS) bool; drawn (N,) bool: whether the mask is to be learnt; counts (N,) bool: whether its quality is."""

    squares: Tensor
    category: Tensor
    score: Tensor
    truth: Tensor
    drawn: Tensor
    counts: Tensor


class RefinementData:
    """A data set, or one rank's part of it, as bytes on the device, and the detector's detections in it. It may
    grow."""

    def __init__(self, detector: Detector, device: torch.device) -> None:
        """detector: as it was trained; it must not have been trained on the images that come."""
        self._detector = detector.fuse().to(device).to(memory_format=torch.channels_last)
        self._store = DeviceStore(device, tools=False)
        self.detections: Detections | None = None
        self.validation = self._drawn = self._judged = torch.empty(0, dtype=torch.long, device=device)

    def extend(self, more: SegmentationImages) -> None:
        """Take in more images, all of one size, and look at them."""
        device, first, n = self._store.device, len(self._store), len(more.rgb)
        self._store.extend(more)
        categories = torch.from_numpy(more.categories).to(device)
        found = [] if self.detections is None else [self.detections]
        for rows in torch.split(torch.arange(n, device=device), _AT_ONCE):
            zooms = zoom_of(first + rows)
            for zoom in _ZOOMS:
                some = rows[zooms == zoom]
                if len(some):
                    found.append(self._look(first + some, categories[some], zoom))
        self.detections = Detections.cat(found)
        aside, drawn = is_validation(self.detections.image), self.detections.truth > 0
        self._drawn, self._judged = (torch.nonzero(rows & ~aside)[:, 0] for rows in (drawn, ~drawn))
        self.validation = torch.nonzero(aside & drawn & self.detections.counts)[:, 0]

    @property
    def ready(self) -> bool:
        """Whether there is anything to learn from."""
        return len(self._drawn) > 0

    def __len__(self) -> int:
        """How many images."""
        return len(self._store)

    def batch(self, count: int) -> Examples:
        """Examples for training, drawn and varied at random."""
        drawn = round(DRAWN_SHARE * count) if len(self._judged) else count
        picks = [
            rows[torch.randint(len(rows), (n,), device=rows.device)]
            for rows, n in ((self._drawn, drawn), (self._judged, count - drawn))
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
        """The detections `which` (N,), as they are seen after training."""
        assert self.detections is not None
        detections = self.detections.of(which)
        return self._examples(detections, Squares.about(detections.boxes), detections.score)

    def _examples(self, detections: Detections, squares: Squares, score: Tensor) -> Examples:
        images, index = torch.unique(detections.image, return_inverse=True)
        shown = Images(self._store.rgb[images], self._store.depth(images), self._store.focal[images])
        seen, pixels = look(shown, index, squares, detections.mask_at())
        truth = (
            self._ids(detections.image, pixels)
            == torch.where(detections.truth > 0, detections.truth, 255)[:, None, None]
        )
        return Examples(seen, detections.category, score, truth, detections.truth > 0, detections.counts)

    def _ids(self, image: Tensor, pixels: Tensor) -> Tensor:
        """Ids of the EEs (N, CELLS, CELLS) at pixels (N, 2, CELLS, CELLS), 0 beyond the image."""
        column, row = pixels.clamp(min=0).unbind(1)
        return torch.where(pixels[:, 0] >= 0, self._store.maps[image[:, None, None], 0, row, column], 0)

    def _look(self, image: Tensor, categories: Tensor, zoom: float) -> Detections:
        """The detector's detections in the images `image` (B,), seen `zoom` times as large as at its first look, of
        which categories (B, E) has the EEs' class indices."""
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
        """With `truth` and `counts`; categories (N, E): class index of EE id 1..E of each find's image."""
        if not len(detections):
            return detections
        zero = torch.zeros(len(detections), dtype=torch.long, device=detections.image.device)
        blank = torch.zeros((1, *self._store.maps.shape[2:]), device=zero.device)
        images = Images(blank[..., None].expand(-1, -1, -1, 3), blank, zero[:1] + 1.0)
        seen, pixels = look(images, zero, Squares.about(detections.boxes), detections.mask_at())
        mask, ids = seen[:, -1] > 0, self._ids(detections.image, pixels)
        ious = []
        for ee in range(1, categories.shape[1] + 1):
            there = (ids == ee) & (categories[:, ee - 1] == detections.category + 1)[:, None, None]
            ious.append((there & mask).sum((1, 2)) / (there | mask).sum((1, 2)).clamp(min=1))
        best, which = torch.stack(ious, 1).max(1)
        truth = torch.where(best >= DRAWN, which + 1, 0).to(torch.uint8)
        shown = (self._store.maps[detections.image, 0] == truth[:, None, None]).sum((1, 2))
        return replace(detections, truth=truth, counts=(truth == 0) | (shown >= MIN_POINTS))


def zoom_of(image: Tensor) -> Tensor:
    """How much larger than at its first look the detector sees images (N,): two of each in turn, so that those kept
    aside are of both sizes."""
    return image.new_tensor(_ZOOMS, dtype=torch.float64)[image // 2 % len(_ZOOMS)]


def is_validation(image: Tensor) -> Tensor:
    """Which of images (N,) are not trained on."""
    return image % VALIDATION == 0
