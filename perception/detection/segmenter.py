"""The segmenter: a trained Mask R-CNN with zoom pass and mask refinement, from an RGB-D frame to instance masks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.perception.detection.backbone import paste_one
from toolee_robot.perception.detection.detector import CLASSES, TOOL, Detector, RawDetections, trained_detector
from toolee_robot.perception.detection.inputs import DetectorConfig, RgbdBatch, encode_rgbd, working_size
from toolee_robot.perception.detection.instances import Instance, associate, without_duplicates
from toolee_robot.perception.detection.passes import (
    MIN_PROBABILITY,
    Crop,
    coarse_size,
    crops,
    cut,
    merge,
    merge_coarse,
    placed,
)
from toolee_robot.perception.detection.refiner import MaskRefinement
from toolee_robot.perception.precision import in_bfloat16, prefers_bfloat16, torch_device
from toolee_robot.types import Detection, RgbdFrame

EVERYTHING = 0.02
"""Score threshold for evaluation: average precision also ranks the weak detections."""


@dataclass(frozen=True)
class Stages:
    """Stages after the network's first pass, each of which costs time."""

    coarse: bool
    """A scene seen finer than the tools of the training is seen again at their scale (`passes`)."""
    zoomed: bool
    """Tools whose end effector is missing or doubtful are detected again, enlarged (`passes`)."""
    mirrored: bool
    """Detections are classified and segmented again in the mirror image of the part about them."""
    refined: bool
    """The end effectors' masks are refined (`refiner`)."""


WHOLE_IMAGE = Stages(coarse=True, zoomed=True, mirrored=True, refined=True)
"""Stages for an image of which nothing is known."""
IN_CROP = Stages(coarse=False, zoomed=False, mirrored=False, refined=False)
"""Stages for a crop about the hand that holds the tool: none gains there (`evaluate held` of commit 1855b4dc)."""


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
        self._device = torch_device(device)
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
        device = torch_device(device)
        bfloat16 = prefers_bfloat16(device) if bfloat16 is None else bfloat16
        return cls(trained_detector(weights_dir), device, bfloat16, MaskRefinement.load(weights_dir, device, bfloat16))

    def detect(
        self, frame: RgbdFrame, categories: Sequence[Category] = CATEGORIES, crop: Crop | None = None
    ) -> list[Detection]:
        """Detect the end effectors in a frame.

        Args:
            frame: Colour image with registered depth [m], any size.
            categories: The categories wanted.
            crop: The part of the frame to look at; None: all of it.

        Returns:
            Detections, best score first, each with the mask of its tool where that is seen; in the whole frame's
            pixels.
        """
        instances = self.instances(frame) if crop is None else self.instances_in(frame, crop, categories)
        return [d for d in associate(instances) if d.category in categories]

    def instances(
        self, frame: RgbdFrame, score_threshold: float | None = None, stages: Stages = WHOLE_IMAGE
    ) -> list[Instance]:
        """Detect and segment every instance, whole tools included.

        Args:
            frame: Colour image with registered depth [m], any size.
            score_threshold: Least score of an end effector, and least class probability of anything in a pass; None:
                the configured one.
            stages: Stages after the first pass.

        Returns:
            The instances, in the frame's own size.
        """
        height, width = image = frame.depth.shape
        threshold = self.config.score_threshold if score_threshold is None else score_threshold
        size = working_size(height, width, self.config.working_pixels)
        found = self._detect_at(frame, size, threshold, stages.mirrored)
        zoomed = crops(found, image, size, self.config.working_pixels) if stages.zoomed else []
        if zoomed:
            least = max(threshold, MIN_PROBABILITY)
            second = [placed(self._detect_in(frame, c, least, stages.mirrored), c, image) for c in zoomed]
            found = without_duplicates(merge(found, second, zoomed, image))
        coarse = coarse_size(frame, size) if stages.coarse else None
        if coarse is not None:
            found = merge_coarse(found, self._detect_at(frame, coarse, threshold, stages.mirrored))
        # Mirrored passes and mask quality have lowered the scores since the class probability was judged.
        found = [i for i in found if i.label == TOOL or i.score >= threshold]  # tools tell about end effectors
        return self._refinement(frame, found) if stages.refined and self._refinement is not None else found

    def instances_in(
        self, frame: RgbdFrame, crop: Crop, categories: Sequence[Category] = CATEGORIES, stages: Stages = IN_CROP
    ) -> list[Instance]:
        """Detect and segment tools and the end effectors of some categories in a crop.

        Args:
            frame: Colour image with registered depth [m], any size.
            crop: The part of it to look at.
            categories: The categories wanted.
            stages: Stages after the first pass; a crop is not zoomed into.

        Returns:
            The instances, in the frame's own size.
        """
        height, width = frame.depth.shape
        wanted = [TOOL, *(CLASSES.index(c.value) for c in categories)]
        seen = self._detect_in(frame, crop, MIN_PROBABILITY, stages.mirrored, wanted)
        found = placed(seen, crop, (height, width), tools_cut_off=True)
        return self._refinement(frame, found) if stages.refined and self._refinement is not None else found

    def _detect_in(
        self, frame: RgbdFrame, crop: Crop, threshold: float, mirrored: bool, labels: Sequence[int] | None = None
    ) -> list[Instance]:
        """The network's detections in a crop, in the crop's pixels."""
        return self._detect_at(cut(frame, crop), crop.size, threshold, mirrored, labels)

    def _detect_at(
        self,
        frame: RgbdFrame,
        size: tuple[int, int],
        threshold: float,
        mirrored: bool,
        labels: Sequence[int] | None = None,
    ) -> list[Instance]:
        """The network's detections in a frame that it sees at `size` (height, width)."""
        batch, scale = self._prepare(frame, size)
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self._bfloat16):
            raw = self._detector.detect(batch, threshold, mirrored=mirrored, labels=labels)[0]
        return without_duplicates(paste(raw, scale, *frame.depth.shape))

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


def paste(raw: RawDetections, scale: tuple[float, float], height: int, width: int) -> list[Instance]:
    """Resample the network's masks into the full image.

    Args:
        raw: Detections of one image, in the network's input.
        scale: Factors (x, y) from the input's pixels to the image's.
        height: Image height [px].
        width: Image width [px].

    Returns:
        The instances in the image; those whose mask is empty are dropped.
    """
    instances = []
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
            x0, y0, x1, y1 = (float(v) for v in np.clip(box * factors, 0.0, limits))
            instances.append(Instance(mask, int(label), float(score), (x0, y0, x1, y1)))
    return instances
