"""A tiny mask refiner and toy pictures for the tests of the refiner."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from tests.perception.toy_scenes import enlarged, toy_scenes
from toolee_robot.perception.detection.inputs import DetectorConfig
from toolee_robot.perception.detection.instances import Box, Instance
from toolee_robot.perception.detection.refiner import CELLS, CHANNELS, Refiner, RefinerConfig
from toolee_robot.perception.offline.dataset.records import HEIGHT, WIDTH
from toolee_robot.perception.offline.dataset.scenes import SegmentationSet
from toolee_robot.perception.offline.training.refiner_training import (
    Detections,
    RefinementTraining,
)
from toolee_robot.types import CameraIntrinsics, RgbdFrame

CPU = torch.device("cpu")
TIMES = 8
"""A toy's pixel is so many of the data set's wide: the detector sees the former."""
TINY_DETECTOR = DetectorConfig(
    widths=(8, 12, 16, 24),
    fpn_channels=16,
    box_features=32,
    mask_layers=1,
    mask_width=8,
    working_pixels=(HEIGHT // TIMES) * (WIDTH // TIMES),
    pre_nms=50,
    post_nms=20,
)
TINY = RefinerConfig(widths=(8, 12, 16, 24))


def toys(count: int, seed: int = 0) -> SegmentationSet:
    """Of the data set's size."""
    return enlarged(toy_scenes(count, seed, HEIGHT // TIMES, WIDTH // TIMES), TIMES)


def training(data: Path, out: Path, detector: Path, **options: object) -> RefinementTraining:
    given = {"batch": 4, "lr": 1e-2, "warmup_steps": 5, "ema": 0.9, "device": "cpu", "model": TINY, **options}
    return RefinementTraining(data, out, detector=detector, **given)  # type: ignore[arg-type]


def described(folder: Path) -> dict[str, object]:
    description: dict[str, object] = json.loads((folder / "refinement.json").read_text())
    return description


def used(refiner: Refiner) -> Refiner:
    """With weights and statistics of batch normalisation other than those it begins with."""
    torch.manual_seed(1)
    for module in refiner.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.uniform_(module.weight, 0.5, 1.5)
            nn.init.normal_(module.bias, std=0.2)
        if isinstance(module, nn.Linear):
            nn.init.normal_(module.weight, std=0.2)
    refiner.train()
    for _ in range(5):
        refiner(*some_squares(4))
    with torch.inference_mode():
        refiner.eval().output.bias -= refiner(*some_squares(4))[0].mean()
    return refiner


def some_squares(count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Squares, categories and scores, at random."""
    squares = torch.cat([255 * torch.rand(count, 3, CELLS, CELLS), torch.randn(count, CHANNELS - 3, CELLS, CELLS)], 1)
    return squares, torch.arange(count) % 4, torch.rand(count)


def dilated(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return cv2.dilate(mask.astype(np.uint8), np.ones((33, 33), np.uint8)) > 0


def eroded(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return cv2.erode(mask.astype(np.uint8), np.ones((33, 33), np.uint8)) > 0


def shifted(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.roll(mask, (2 * TIMES, -2 * TIMES), (0, 1))


def box_of(mask: NDArray[np.bool_]) -> Box:
    rows, columns = np.nonzero(mask)
    return float(columns.min()), float(rows.min()), float(columns.max()) + 1, float(rows.max()) + 1


def masks_of(found: Detections) -> NDArray[np.bool_]:
    """Mask in the image of every detection."""
    row, column = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    return found.mask_at()(column.expand(len(found), -1, -1), row.expand(len(found), -1, -1)).numpy()


def noise(unknown: float = 0.0) -> tuple[RgbdFrame, list[Instance]]:
    """An image with holes in its depth, said to be `unknown`, and something found in it."""
    rng = np.random.default_rng(4)
    rgb = rng.integers(0, 255, (60, 80, 3), dtype=np.uint8)
    depth = rng.uniform(0.5, 0.6, (60, 80)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = unknown
    mask = np.zeros(depth.shape, dtype=np.bool_)
    mask[20:41, 12:33] = True
    frame = RgbdFrame(rgb, depth, CameraIntrinsics(200.0, 200.0, 39.5, 29.5, 80, 60))
    return frame, [Instance(mask, 2, 0.5, (12.0625, 20.0625, 32.9375, 40.9375))]
