"""The segmenter: a trained Mask R-CNN with zoom pass and mask refinement, from an RGB-D frame to instance masks."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch

from toolee_robot.perception.detection.config import DetectorConfig, working_size
from toolee_robot.perception.detection.detector import (
    Detector,
    RawDetections,
)
from toolee_robot.perception.detection.detector_weights import trained_detector
from toolee_robot.perception.detection.inputs import RgbdBatch, encode_rgbd
from toolee_robot.perception.detection.instances import Instances, associate, without_duplicates
from toolee_robot.perception.detection.mask_head import paste_one
from toolee_robot.perception.detection.refiner.mask_refinement import MaskRefinement
from toolee_robot.perception.detection.zoom_pass import MIN_PROBABILITY, crops, cut, merge, placed
from toolee_robot.perception.precision import in_bfloat16, prefers_bfloat16
from toolee_robot.types import Detection, RgbdFrame

EVERYTHING = 0.02
"""Score threshold for evaluation: average precision also ranks the weak detections."""


class Segmenter:
    """A trained detector for images of any size. Thread-safe once loaded: inference keeps no state.

    Args:
        detector: The trained network; its batch normalisation is fused in place.
        device: torch device that runs it.
        bfloat16: Whether a CPU computes in bfloat16; None: where it is faster, see `prefers_bfloat16`.
        refinement: Refines the end effectors' masks; None: they stay as the detector's mask head predicts them.

    Attributes:
        config: Architecture and inference settings of the detector.
    """

    def __init__(
        self,
        detector: Detector,
        device: torch.device | str = "cpu",
        bfloat16: bool | None = None,
        refinement: MaskRefinement | None = None,
    ) -> None:
        self._device = torch.device(device)
        self._bfloat16 = prefers_bfloat16(self._device) if bfloat16 is None else bfloat16
        self._refinement = refinement
        self._detector = detector.fuse().to(self._device).to(memory_format=torch.channels_last)
        if self._bfloat16:
            in_bfloat16(self._detector)
        self.config: DetectorConfig = detector.config

    @classmethod
    def load(
        cls, weights_dir: Path | None = None, device: torch.device | str = "cpu", bfloat16: bool | None = None
    ) -> Segmenter:
        """Load the shipped detector, or the one of a training, with the refiner beside it where there is one.

        Args:
            weights_dir: Folder of weights; None: the shipped ones.
            device: torch device that runs them.
            bfloat16: See `Segmenter`.

        Returns:
            The segmenter, ready.

        Raises:
            AssetError: A weight file is missing or unreadable; the message names it.
        """
        device = torch.device(device)
        bfloat16 = prefers_bfloat16(device) if bfloat16 is None else bfloat16
        return cls(trained_detector(weights_dir), device, bfloat16, MaskRefinement.load(weights_dir, device, bfloat16))

    def detect(self, frame: RgbdFrame) -> list[Detection]:
        """Detect the end effectors in a frame.

        Args:
            frame: Colour image with registered depth [m], any size.

        Returns:
            Detections, best score first, each with the mask of its tool where that is seen.
        """
        return associate(*self.instances(frame))

    def instances(self, frame: RgbdFrame, score_threshold: float | None = None) -> Instances:
        """Detect and segment every instance, whole tools included.

        Tools without a confidently detected EE are seen again, enlarged (`zoom_pass`); the EEs' masks are then refined
        (`refiner`).

        Args:
            frame: Colour image with registered depth [m], any size.
            score_threshold: Least class probability; None: the configured one.

        Returns:
            Masks, labels, scores and boxes in the frame's own size.
        """
        instances = self._both_passes(frame, score_threshold)
        return instances if self._refinement is None else self._refinement(frame, instances)

    def _both_passes(self, frame: RgbdFrame, score_threshold: float | None) -> Instances:
        """Instances of the first pass, merged with those of the zoom pass."""
        height, width = frame.depth.shape
        threshold = self.config.score_threshold if score_threshold is None else score_threshold
        size = working_size(height, width, self.config.working_pixels)
        first = self._detect_at(frame, size, threshold)
        zoomed = crops(first, (height, width), size, self.config.working_pixels)
        if not zoomed:
            return first
        second = []
        for crop in zoomed:
            seen = self._detect_at(cut(frame, crop), crop.size, max(threshold, MIN_PROBABILITY))
            second.append(placed(seen, crop, (height, width)))
        return without_duplicates(*merge(first, second, zoomed, (height, width)))

    def _detect_at(self, frame: RgbdFrame, size: tuple[int, int], threshold: float) -> Instances:
        """The network's detections in a frame that it sees at `size` (height, width)."""
        batch, scale = self._prepare(frame, size)
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self._bfloat16):
            raw = self._detector.detect(batch, threshold)[0]
        return without_duplicates(*paste(raw, scale, *frame.depth.shape))

    def _prepare(self, frame: RgbdFrame, size: tuple[int, int]) -> tuple[RgbdBatch, tuple[float, float]]:
        """Network input of `size` (height, width) and the factors (x, y) from its pixels to the image's."""
        (height, width), (h, w) = frame.depth.shape, size
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
    """Resample the network's masks into the full image.

    Args:
        raw: Detections of one image, in the network's input.
        scale: Factors (x, y) from the input's pixels to the image's.
        height: Image height [px].
        width: Image width [px].

    Returns:
        Masks (H, W), labels, scores and boxes [px] in the image; instances whose mask is empty are dropped.
    """
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
        mask = paste_one(patch, covered * factors, height, width)
        if mask.any():
            x0, y0, x1, y1 = np.clip(box * factors, 0.0, limits)
            masks.append(mask)
            labels.append(int(label))
            scores.append(float(score))
            boxes.append((float(x0), float(y0), float(x1), float(y1)))
    return masks, labels, scores, boxes
