"""The tool's end effectors found in an RGB-D image: instance masks by a Mask R-CNN."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from toolee_robot.errors import AssetError
from toolee_robot.perception.assets import load_weights
from toolee_robot.perception.segmentation_input import RgbdBatch, encode_rgbd
from toolee_robot.perception.segmentation_model import (
    CLASSES,
    TOOL,
    WEIGHTS_NAME,
    Detector,
    DetectorConfig,
    RawDetections,
    load_detector,
    working_size,
)
from toolee_robot.types import Category, Detection, RgbdFrame

LEAST_TOOL_OVERLAP = 0.5
"""Share of an EE's mask that a tool's mask must cover for the EE to belong to that tool."""

MOST_COVERED = 0.6
"""Share of an instance's mask that a better one of the same class may cover."""

EVERYTHING = 0.02
"""Score threshold for evaluation: AP ranks the weak detections too."""

Box = tuple[float, float, float, float]
Instances = tuple[list[NDArray[np.bool_]], list[int], list[float], list[Box]]
"""Masks (H, W), labels, scores and boxes [px] of one image, in the image's own size."""


class Segmenter:
    """A trained detector, ready for images of any size. Thread-safe once loaded: inference keeps no state."""

    def __init__(self, detector: Detector, device: torch.device | str = "cpu") -> None:
        self._device = torch.device(device)
        self._detector = detector.fuse().to(self._device).to(memory_format=torch.channels_last)
        self.config: DetectorConfig = detector.config

    @classmethod
    def load(cls, weights_dir: Path | None = None, device: torch.device | str = "cpu") -> Segmenter:
        """The shipped detector, or the one a training run left in `weights_dir`.

        Raises AssetError that names the missing or unreadable file.
        """
        tensors, description = load_weights(weights_dir, WEIGHTS_NAME)
        try:
            detector = Detector(DetectorConfig.from_json(description["model"]))
        except (KeyError, TypeError, ValueError) as error:
            raise AssetError(f"the detector's description is damaged, fetch it again: {error!r}") from error
        load_detector(detector, tensors, description)
        return cls(detector, device)

    def detect(self, frame: RgbdFrame) -> list[Detection]:
        """End effectors in an image, best score first, each with its tool's mask where seen."""
        return associate(*self.instances(frame))

    def instances(self, frame: RgbdFrame, score_threshold: float | None = None) -> Instances:
        """Every instance, whole tools among them, over `score_threshold` (the configured one if None)."""
        height, width = frame.depth.shape
        batch, scale = self._prepare(frame)
        return without_duplicates(*paste(self._detector.detect(batch, score_threshold)[0], scale, height, width))

    def _prepare(self, frame: RgbdFrame) -> tuple[RgbdBatch, tuple[float, float]]:
        """Network input and the factors (x, y) from its pixels to the image's."""
        height, width = frame.depth.shape
        h, w = working_size(height, width, self.config.working_pixels)
        rgb, depth = frame.rgb, np.nan_to_num(frame.depth, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
        if (h, w) != (height, width):
            method = cv2.INTER_AREA if h < height else cv2.INTER_LINEAR
            rgb = cv2.resize(rgb, (w, h), interpolation=method).astype(np.uint8)
            depth = cv2.resize(depth, (w, h), interpolation=cv2.INTER_NEAREST_EXACT).astype(np.float32)
        K = frame.intrinsics
        focal = math.sqrt(K.fx * K.fy * (w / width) * (h / height))
        batch = encode_rgbd(
            torch.from_numpy(np.ascontiguousarray(rgb)).to(self._device).permute(2, 0, 1)[None],
            torch.from_numpy(depth).to(self._device)[None],
            torch.tensor([focal], dtype=torch.float32, device=self._device),
        )
        pixels = batch.pixels.contiguous(memory_format=torch.channels_last)
        return replace(batch, pixels=pixels), (width / w, height / h)


def paste(raw: RawDetections, scale: tuple[float, float], height: int, width: int) -> Instances:
    """Full-size masks (H, W), labels, scores and boxes [px of the image] from the network's output."""
    masks, labels, scores, boxes = [], [], [], []
    factors = np.array([*scale, *scale])
    limits = np.array([width, height, width, height], dtype=np.float64)
    for box, covered, score, label, patch in zip(
        raw.boxes.cpu().numpy(),
        raw.mask_boxes.cpu().numpy(),
        raw.scores.tolist(),
        raw.labels.tolist(),
        raw.masks.cpu().numpy(),
        strict=True,
    ):
        mask = _paste_one(patch, covered * factors, height, width)
        if mask.any():
            x0, y0, x1, y1 = np.clip(box * factors, 0.0, limits)
            masks.append(mask)
            labels.append(int(label))
            scores.append(float(score))
            boxes.append((float(x0), float(y0), float(x1), float(y1)))
    return masks, labels, scores, boxes


def without_duplicates(
    masks: list[NDArray[np.bool_]], labels: list[int], scores: list[float], boxes: list[Box]
) -> Instances:
    """The instances, best score first, without those of which a better one of the same class covers most: the boxes of
    a slanting, thin thing found twice hardly overlap."""
    kept: list[int] = []
    for i in sorted(range(len(masks)), key=lambda i: -scores[i]):
        same = [k for k in kept if labels[k] == labels[i]]
        if all(np.count_nonzero(masks[k] & masks[i]) <= MOST_COVERED * np.count_nonzero(masks[i]) for k in same):
            kept.append(i)
    return [masks[i] for i in kept], [labels[i] for i in kept], [scores[i] for i in kept], [boxes[i] for i in kept]


def associate(
    masks: list[NDArray[np.bool_]],
    labels: list[int],
    scores: list[float],
    boxes: list[Box],
) -> list[Detection]:
    """EE detections, best first, each with the mask of the tool that covers most of it."""
    tools = [(m, score) for m, label, score in zip(masks, labels, scores, strict=True) if label == TOOL]
    found = []
    for mask, label, score, box in zip(masks, labels, scores, boxes, strict=True):
        if label == TOOL:
            continue
        overlaps = [float((mask & tool).sum()) / float(mask.sum()) for tool, _ in tools]
        best = int(np.argmax(overlaps)) if overlaps else -1
        tool_mask, tool_score = None, 0.0
        if overlaps and overlaps[best] >= LEAST_TOOL_OVERLAP:
            tool_mask, tool_score = tools[best][0] | mask, tools[best][1]
        found.append(Detection(Category(CLASSES[label]), score, mask, box, tool_mask, tool_score))
    return sorted(found, key=lambda d: -d.score)


def _paste_one(patch: NDArray[np.float32], box: NDArray[np.float64], height: int, width: int) -> NDArray[np.bool_]:
    """Bilinear resampling of a mask's probabilities (S, S) from its box, which may reach beyond the image, to the
    image's pixel centres, over 0.5."""
    x0, y0, x1, y1 = (float(v) for v in box)
    mask = np.zeros((height, width), dtype=np.bool_)
    c0, c1 = max(int(np.floor(x0)), 0), min(int(np.ceil(x1)), width)
    r0, r1 = max(int(np.floor(y0)), 0), min(int(np.ceil(y1)), height)
    if c1 <= c0 or r1 <= r0 or x1 - x0 < 0.5 or y1 - y0 < 0.5:
        return mask
    size = patch.shape[0]
    u = (np.arange(c0, c1) + 0.5 - x0) / (x1 - x0) * size - 0.5
    v = (np.arange(r0, r1) + 0.5 - y0) / (y1 - y0) * size - 0.5
    grid_u, grid_v = np.meshgrid(u.astype(np.float32), v.astype(np.float32))
    values = cv2.remap(patch, grid_u, grid_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    mask[r0:r1, c0:c1] = values > 0.5
    return mask
