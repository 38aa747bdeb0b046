"""Batched box operations: coding against anchors, overlap, suppression. Boxes are x0, y0, x1, y1 [px]."""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor

ANCHOR_RATIOS = (0.5, 1.0, 2.0)

_STRIDES = (8, 16, 32, 64)
_LOG_LIMIT = math.log(1000.0 / 16.0)


def encode(boxes: Tensor, anchors: Tensor, weights: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)) -> Tensor:
    """Encode boxes relative to anchors (Ren et al., Faster R-CNN, 2015).

    Args:
        boxes: (..., 4).
        anchors: (..., 4).
        weights: Factors on the deltas (dx, dy, dw, dh).

    Returns:
        Deltas (..., 4).
    """
    size_a, size_b = (anchors[..., 2:] - anchors[..., :2]).clamp(min=1e-3), (boxes[..., 2:] - boxes[..., :2])
    shift = (boxes[..., 2:] + boxes[..., :2] - anchors[..., 2:] - anchors[..., :2]) / 2 / size_a
    scale = torch.log(size_b.clamp(min=1e-3) / size_a)
    return torch.cat([shift, scale], -1) * shift.new_tensor(weights)


def decode(deltas: Tensor, anchors: Tensor, weights: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)) -> Tensor:
    """Decode boxes; the inverse of `encode`.

    Args:
        deltas: (..., 4).
        anchors: (..., 4).
        weights: Factors on the deltas, as for `encode`.

    Returns:
        Boxes (..., 4).
    """
    deltas = deltas / deltas.new_tensor(weights)
    size = anchors[..., 2:] - anchors[..., :2]
    centre = (anchors[..., 2:] + anchors[..., :2]) / 2 + deltas[..., :2] * size
    half = deltas[..., 2:].clamp(max=_LOG_LIMIT).exp() * size / 2
    return torch.cat([centre - half, centre + half], -1)


def clip(boxes: Tensor, height: int, width: int) -> Tensor:
    """Clip boxes to the image.

    Not-a-number corners, which a diverging training produces, become 0: an operator that reads features there would
    kill the process before the loss can be checked.

    Args:
        boxes: (..., 4).
        height: Image height [px].
        width: Image width [px].

    Returns:
        Boxes (..., 4).
    """
    limit = boxes.new_tensor([width, height, width, height])
    return torch.minimum(boxes.nan_to_num(0.0, 0.0, 0.0).clamp(min=0.0), limit)


def mirror_boxes(boxes: Tensor, width: int) -> Tensor:
    """Mirror boxes left to right.

    Args:
        boxes: Boxes x0, y0, x1, y1, (N, 4) [px].
        width: Width of the image [px].

    Returns:
        The boxes in the mirror image, (N, 4) [px].
    """
    x0, y0, x1, y1 = boxes.unbind(1)
    return torch.stack([width - x1, y0, width - x0, y1], 1)


def pairwise_iou(a: Tensor, b: Tensor) -> Tensor:
    """Intersection over union of every box of one set with every box of another.

    Args:
        a: Boxes, (..., N, 4) [px].
        b: Boxes, (..., M, 4) [px].

    Returns:
        Intersection over union in [0, 1], (..., N, M).
    """
    a, b = a[..., :, None, :], b[..., None, :, :]
    overlap = (torch.minimum(a[..., 2:], b[..., 2:]) - torch.maximum(a[..., :2], b[..., :2])).clamp(min=0).prod(-1)
    area_a, area_b = (a[..., 2:] - a[..., :2]).prod(-1), (b[..., 2:] - b[..., :2]).prod(-1)
    return overlap / (area_a + area_b - overlap).clamp(min=1e-6)


def greedy_suppression(boxes: Tensor, threshold: float, iterations: int = 8) -> Tensor:
    """Batched greedy non-maximum suppression.

    Fixed-point iteration (Zheng et al. 2021, cluster NMS): exact once it has run as often as the longest chain of
    suppressions; batched and free of host synchronisation.

    Args:
        boxes: (B, N, 4), sorted by falling score.
        threshold: IoU above which the worse box is suppressed.
        iterations: Number of iterations.

    Returns:
        Which boxes survive, (B, N) bool.
    """
    n = boxes.shape[1]
    above = torch.ones((n, n), dtype=torch.bool, device=boxes.device).triu(1)
    overlaps = (pairwise_iou(boxes, boxes) > threshold) & above
    keep = torch.ones(boxes.shape[:2], dtype=torch.bool, device=boxes.device)
    for _ in range(iterations):
        keep = ~(overlaps & keep[:, :, None]).any(1)
    return keep


@lru_cache(maxsize=8)
def anchor_boxes(sizes: tuple[tuple[float, float], ...], height: int, width: int, device: torch.device) -> list[Tensor]:
    """Anchor boxes of an input.

    Args:
        sizes: Square roots of the anchors' areas [px], per pyramid level (strides 8 to 64).
        height: Input height [px].
        width: Input width [px].
        device: torch device of the result.

    Returns:
        Per level, anchors (A_l, 4).
    """
    levels = []
    for stride, scales in zip(_STRIDES, sizes, strict=True):
        ratio = torch.tensor(ANCHOR_RATIOS).repeat(len(scales))
        scale = torch.tensor(scales).repeat_interleave(len(ANCHOR_RATIOS))
        half = torch.stack([scale / ratio.sqrt(), scale * ratio.sqrt()], 1) / 2
        ys = (torch.arange(-(-height // stride)) + 0.5) * stride
        xs = (torch.arange(-(-width // stride)) + 0.5) * stride
        y, x = torch.meshgrid(ys, xs, indexing="ij")
        centre = torch.stack([x, y], -1)[:, :, None]
        levels.append(torch.cat([centre - half, centre + half], -1).reshape(-1, 4).to(device))
    return levels
