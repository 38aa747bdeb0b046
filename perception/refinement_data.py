"""What the refiner is trained on: images on the device, and what a detector finds in them."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from toolee_robot.errors import AssetError
from toolee_robot.perception.dataset.records import HEIGHT, WIDTH
from toolee_robot.perception.dataset.scene_reader import load_scenes, read_json, scene_folders
from toolee_robot.perception.segmentation_crops import Images, MaskAt, Squares, look
from toolee_robot.perception.segmentation_data import recolour
from toolee_robot.perception.segmentation_input import encode_rgbd
from toolee_robot.perception.segmentation_losses import EE_PIXELS
from toolee_robot.perception.segmentation_model import TOOL, Detector, working_size

LEAST_SCORE = 0.02
"""Weaker finds are no example: as `segmentation.EVERYTHING`, what an evaluation ranks."""
DRAWN = 0.25
"""A detection whose mask overlaps the truth's by this much (IoU) is drawn; others are only judged."""
DRAWN_SHARE = 0.75
"""Share of a batch's examples that are."""
VALIDATION = 50
"""Every so many-th image is kept for validation."""
_AT_ONCE = 64


@dataclass(frozen=True)
class Finds:
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

    def of(self, which: Tensor) -> Finds:
        """Some of them."""
        return Finds(*(getattr(self, f.name)[which] for f in fields(self)))

    @staticmethod
    def cat(several: list[Finds]) -> Finds:
        """All of them in one."""
        return Finds(*(torch.cat([getattr(each, f.name) for each in several]) for f in fields(Finds)))

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
    """A data set as bytes on the device, and the detector's finds in it."""

    def __init__(self, folder: Path, detector: Detector, device: torch.device, threads: int = 8) -> None:
        """folder: of a split. detector: as it was trained; it must not have been trained on these images. Raises
        AssetError naming a missing or broken file."""
        detector = detector.fuse().to(device).to(memory_format=torch.channels_last)
        scenes = scene_folders(folder)
        if not scenes:
            raise AssetError(f"no scene in {folder}: give the folder train of a data set that is finished")
        counts = [len(read_json(scene / "scene_camera.json")) for scene in scenes]
        n = sum(counts)
        self._rgb = torch.empty((n, HEIGHT, WIDTH, 3), dtype=torch.uint8, device=device)
        self._depth = torch.empty((n, HEIGHT, WIDTH), dtype=torch.int16, device=device)
        self._ee = torch.empty((n, HEIGHT, WIDTH), dtype=torch.uint8, device=device)
        self._focal = torch.empty(n, device=device)
        found, first = [], 0
        with ThreadPoolExecutor(1) as ahead:
            loading = [ahead.submit(load_scenes, [scene], threads=threads) for scene in scenes[:1]]
            for k, count in enumerate(counts):
                data = loading.pop().result()
                if k + 1 < len(scenes):
                    loading.append(ahead.submit(load_scenes, [scenes[k + 1]], threads=threads))
                part = slice(first, first + count)
                self._rgb[part] = torch.from_numpy(data.rgb).to(device)
                millimetres = np.minimum(data.depth_mm, np.iinfo(np.int16).max).astype(np.int16)
                self._depth[part] = torch.from_numpy(millimetres).to(device)
                self._ee[part] = torch.from_numpy(data.ee).to(device)
                focal = np.sqrt(data.intrinsics[:, 0] * data.intrinsics[:, 1]).astype(np.float32)
                self._focal[part] = torch.from_numpy(focal).to(device)
                categories = torch.from_numpy(data.categories).to(device)
                for start in range(0, count, _AT_ONCE):
                    rows = torch.arange(start, min(start + _AT_ONCE, count), device=device)
                    found.append(self._look(detector, first + rows, categories[rows]))
                first += count
        self.finds = Finds.cat(found)
        kept = self.finds.image % VALIDATION == 0
        drawn = self.finds.truth > 0
        self._drawn, self._judged = (torch.nonzero(rows & ~kept)[:, 0] for rows in (drawn, ~drawn))
        self.validation = torch.nonzero(kept & drawn & self.finds.counts)[:, 0]

    def __len__(self) -> int:
        """How many images."""
        return len(self._rgb)

    def batch(self, count: int) -> Examples:
        """Examples for training, drawn and varied at random."""
        drawn = round(DRAWN_SHARE * count) if len(self._judged) else count
        picks = [
            rows[torch.randint(len(rows), (n,), device=rows.device)]
            for rows, n in ((self._drawn, drawn), (self._judged, count - drawn))
            if n
        ]
        finds = self.finds.of(torch.cat(picks))
        score = torch.logit(finds.score, 1e-3)
        score = torch.sigmoid(score + 0.3 * torch.randn_like(score))
        squares = Squares.about(finds.boxes).varied()
        examples = self._examples(finds, squares, score)
        colour = recolour(examples.squares[:, :3], 0.7)
        colour = (
            colour + 4.0 * torch.rand((len(colour), 1, 1, 1), device=colour.device) * torch.randn_like(colour)
        ).clamp(0, 255)
        return replace(examples, squares=torch.cat([colour, examples.squares[:, 3:]], 1))

    def plain(self, which: Tensor) -> Examples:
        """The finds `which` (N,), as they are seen after training."""
        finds = self.finds.of(which)
        return self._examples(finds, Squares.about(finds.boxes), finds.score)

    def _examples(self, finds: Finds, squares: Squares, score: Tensor) -> Examples:
        images, index = torch.unique(finds.image, return_inverse=True)
        depth = self._depth[images].float() / 1000.0
        seen, pixels = look(Images(self._rgb[images], depth, self._focal[images]), index, squares, finds.mask_at())
        truth = self._ids(finds.image, pixels) == torch.where(finds.truth > 0, finds.truth, 255)[:, None, None]
        return Examples(seen, finds.category, score, truth, finds.truth > 0, finds.counts)

    def _ids(self, image: Tensor, pixels: Tensor) -> Tensor:
        """Ids of the EEs (N, CELLS, CELLS) at pixels (N, 2, CELLS, CELLS), 0 beyond the image."""
        column, row = pixels.clamp(min=0).unbind(1)
        return torch.where(pixels[:, 0] >= 0, self._ee[image[:, None, None], row, column], 0)

    def _look(self, detector: Detector, image: Tensor, categories: Tensor) -> Finds:
        """The detector's finds in the images `image` (B,), of which categories (B, E) has the EEs' class indices."""
        rgb = self._rgb[image].permute(0, 3, 1, 2).float()
        depth = self._depth[image].float() / 1000.0
        size = working_size(HEIGHT, WIDTH, detector.config.working_pixels)
        focal = self._focal[image] * math.sqrt(size[0] * size[1] / (HEIGHT * WIDTH))
        rgb = F.interpolate(rgb, size, mode="bilinear", align_corners=False)
        depth = F.interpolate(depth[:, None], size, mode="nearest-exact")[:, 0]
        batch = encode_rgbd(rgb, depth, focal)
        batch = replace(batch, pixels=batch.pixels.contiguous(memory_format=torch.channels_last))
        device = rgb.device.type
        with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
            raw = detector.detect(batch, LEAST_SCORE)
        scale = rgb.new_tensor([WIDTH / size[1], HEIGHT / size[0]]).repeat(2)
        of = torch.cat([torch.full((len(r.boxes),), i, device=rgb.device) for i, r in enumerate(raw)])
        boxes, covered, masks, labels, score = (
            torch.cat([getattr(r, name) for r in raw]).clone()
            for name in ("boxes", "mask_boxes", "masks", "labels", "scores")
        )
        ees = labels != TOOL
        finds = Finds(
            image[of],
            boxes * scale,
            covered * scale,
            (masks.float() * 255).round().to(torch.uint8),
            labels - 1,
            score.float(),
            torch.zeros_like(labels, dtype=torch.uint8),
            torch.ones_like(ees),
        ).of(ees)
        return self._matched(finds, categories[of[ees]])

    def _matched(self, finds: Finds, categories: Tensor) -> Finds:
        """With `truth` and `counts`; categories (N, E): class index of EE id 1..E of each find's image."""
        if not len(finds):
            return finds
        zero = torch.zeros(len(finds), dtype=torch.long, device=finds.image.device)
        blank = torch.zeros((1, HEIGHT, WIDTH), device=zero.device)
        images = Images(blank[..., None].expand(-1, -1, -1, 3), blank, zero[:1] + 1.0)
        seen, pixels = look(images, zero, Squares.about(finds.boxes), finds.mask_at())
        mask, ids = seen[:, -1] > 0, self._ids(finds.image, pixels)
        ious = []
        for ee in range(1, categories.shape[1] + 1):
            there = (ids == ee) & (categories[:, ee - 1] == finds.category + 1)[:, None, None]
            ious.append((there & mask).sum((1, 2)) / (there | mask).sum((1, 2)).clamp(min=1))
        best, which = torch.stack(ious, 1).max(1)
        truth = torch.where(best >= DRAWN, which + 1, 0).to(torch.uint8)
        # What is seen of it in the whole image, at the network's own resolution, decides as it does for the detector.
        pixels_seen = ((self._ee[finds.image] == truth[:, None, None]).sum((1, 2))) if len(finds) else best
        return replace(finds, truth=truth, counts=(truth == 0) | (pixels_seen >= EE_PIXELS))
