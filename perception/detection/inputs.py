"""The detector's configuration and its input: colour, metric pixel size, relief and known depth."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

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


STRIDE = 32
"""Heights and widths of the network's input are multiples of this."""
CHANNELS = 6
"""Channels of the input; see `encode_rgbd`."""

_RELIEF_CELL, _RELIEF_CELLS, _RELIEF_SCALE = 8, 9, 0.05
_NOMINAL_MM_PER_PIXEL = 1.5


@dataclass(frozen=True)
class RgbdBatch:
    """B images as the network takes them, height and width multiples of STRIDE.

    Attributes:
        pixels: (B, CHANNELS, H, W); see `encode_rgbd`.
        depth: (B, H, W) [m] along the optical axis, 0 where unknown.
        focal: Focal length of these images, (B,) [px].
    """

    pixels: Tensor
    depth: Tensor
    focal: Tensor


def encode_rgbd(rgb: Tensor, depth: Tensor, focal: Tensor) -> RgbdBatch:
    """Encode images for the network, padded to multiples of STRIDE.

    Channels: normalised colour (3); log of a pixel's size in millimetres, from which the network can tell lengths;
    relief: how far the pixel lies behind (+) or in front of (-) its surroundings, about 70 px wide, in units of 5 cm,
    clipped to 3; whether the depth is known. The depth channels are 0 where it is not.

    Args:
        rgb: (B, 3, H, W) in 0..255.
        depth: (B, H, W) [m], 0 where unknown.
        focal: (B,) [px].

    Returns:
        The network's input.
    """
    height, width = depth.shape[-2:]
    pad = (0, -width % STRIDE, 0, -height % STRIDE)
    depth = F.pad(depth, pad)[:, None]
    known = (depth > 0).to(depth.dtype)
    size = torch.log(torch.where(depth > 0, 1000.0 * depth / focal.view(-1, 1, 1, 1), _NOMINAL_MM_PER_PIXEL))
    size = size - torch.log(size.new_tensor(_NOMINAL_MM_PER_PIXEL))
    relief = ((depth - _surroundings(depth, known)) / _RELIEF_SCALE).clamp(-3.0, 3.0)
    pixels = torch.cat([F.pad(_normalise(rgb), pad), 2.0 * size, relief * known, known], 1)
    return RgbdBatch(pixels, depth[:, 0], focal)


def part_about(batch: RgbdBatch, boxes: Tensor, margin: int) -> tuple[RgbdBatch, Tensor]:
    """The part of the images that shows some boxes with their surroundings, whole cells of STRIDE pixels.

    Args:
        batch: The input.
        boxes: Boxes x0, y0, x1, y1, (N, 4) [px], N at least 1.
        margin: Least width of the surroundings [px], where the images have so much.

    Returns:
        The part, and the place x, y of its first pixel, (2,) [px].
    """
    limit = boxes.new_tensor([batch.pixels.shape[3], batch.pixels.shape[2]])
    first = ((boxes[:, :2].amin(0) - margin) / STRIDE).floor() * STRIDE
    last = ((boxes[:, 2:].amax(0) + margin) / STRIDE).ceil() * STRIDE
    first = torch.minimum(first.clamp(min=0), limit - STRIDE)
    last = torch.maximum(torch.minimum(last, limit), first + STRIDE)
    (x0, y0), (x1, y1) = first.long().tolist(), last.long().tolist()
    return RgbdBatch(batch.pixels[:, :, y0:y1, x0:x1], batch.depth[:, y0:y1, x0:x1], batch.focal), first


def mirror(batch: RgbdBatch, images: Tensor) -> RgbdBatch:
    """Mirror images left to right. No channel has a direction, so it equals encoding the mirrored image.

    Args:
        batch: The input.
        images: Indices (N,) of the images to mirror.

    Returns:
        The mirrored images, their padding at the left.
    """
    return RgbdBatch(batch.pixels[images].flip(3), batch.depth[images].flip(2), batch.focal[images])


def _surroundings(depth: Tensor, known: Tensor) -> Tensor:
    """Mean of the known depths around each pixel."""
    cells = F.avg_pool2d(torch.cat([depth, known], 1), _RELIEF_CELL)
    sums = F.avg_pool2d(cells, _RELIEF_CELLS, 1, _RELIEF_CELLS // 2)
    return F.interpolate(
        sums[:, :1] / sums[:, 1:].clamp(min=1e-6), depth.shape[-2:], mode="bilinear", align_corners=False
    )


def _normalise(images: Tensor) -> Tensor:
    """Normalise uint8 or float RGB in 0..255 by a fixed mean and deviation."""
    return (images.float() - 110.0) / 60.0
