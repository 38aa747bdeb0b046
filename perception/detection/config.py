"""Configuration of the detector: architecture, inference settings, and the size at which it sees an image."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

MAX_ENLARGEMENT = 2.0
"""Largest factor by which an image is scaled up for the network."""


@dataclass(frozen=True)
class DetectorConfig:
    """Architecture and inference settings; stored beside the weights.

    Attributes:
        widths: Channels of the backbone's four stages.
        fpn_channels: Channels of the feature pyramid.
        box_features: Width of the box head.
        mask_layers: Layers of the mask head at the features' resolution.
        mask_width: Channels of the mask head at the masks' resolution.
        anchor_sizes: Square roots of the anchors' areas [px], two per pyramid level (strides 8 to 64).
        working_pixels: Images are scaled to about this area [px], up by at most MAX_ENLARGEMENT: an EE at 1 m is 20 px
            wide in a depth camera's image, few for a pyramid that begins at stride 4.
        pre_nms: Proposals per level before suppression.
        post_nms: Proposals per image after suppression.
        rpn_nms: IoU above which a proposal is suppressed.
        score_threshold: Least class probability, and least score of an end effector before its mask is refined;
            doubtful detections are kept, because `trust.py` decides what is usable.
        box_nms: IoU above which a detection of the same class is suppressed.
        max_detections: Most detections per image.
    """

    widths: tuple[int, int, int, int] = (64, 128, 256, 384)
    fpn_channels: int = 128
    box_features: int = 512
    mask_layers: int = 4
    mask_width: int = 64
    anchor_sizes: tuple[tuple[float, float], ...] = ((16, 26), (40, 64), (100, 160), (230, 350))
    working_pixels: int = 640 * 530
    pre_nms: int = 200
    post_nms: int = 60
    rpn_nms: float = 0.7
    score_threshold: float = 0.08
    box_nms: float = 0.5
    max_detections: int = 12

    def to_json(self) -> dict[str, Any]:
        """The fields as a JSON object."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> DetectorConfig:
        """Read the fields from a JSON object. Raises KeyError, TypeError or ValueError when it is damaged."""
        sizes = tuple((float(a), float(b)) for a, b in data["anchor_sizes"])
        return cls(**{**data, "widths": tuple(data["widths"]), "anchor_sizes": sizes})


def working_size(height: int, width: int, pixels: int) -> tuple[int, int]:
    """Size at which the network sees an image.

    Args:
        height: Image height [px].
        width: Image width [px].
        pixels: Wanted area [px].

    Returns:
        Height and width [px], scaled up by at most MAX_ENLARGEMENT.
    """
    factor = min(MAX_ENLARGEMENT, math.sqrt(pixels / (height * width)))
    return max(1, round(height * factor)), max(1, round(width * factor))
