"""Instances of one image: duplicates removed, end effectors associated with their tools."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolee_robot.end_effectors import Category
from toolee_robot.perception.detection.detector import CLASSES, TOOL
from toolee_robot.types import Detection

MIN_TOOL_OVERLAP = 0.5
"""Share of an EE's mask that a tool's mask must cover for the EE to belong to that tool."""

MAX_COVERED = 0.6
"""Largest share of an instance's mask that a better one of the same class may cover."""

Box = tuple[float, float, float, float]
Instances = tuple[list[NDArray[np.bool_]], list[int], list[float], list[Box]]
"""Masks (H, W), labels, scores and boxes [px] of one image, in the image's own size."""


def without_duplicates(
    masks: list[NDArray[np.bool_]], labels: list[int], scores: list[float], boxes: list[Box]
) -> Instances:
    """Remove instances that a better one of the same class mostly covers.

    By masks, because the boxes of a slanting, thin object detected twice hardly overlap.

    Args:
        masks: Masks (H, W).
        labels: Class indices.
        scores: Scores in [0, 1].
        boxes: Boxes [px].

    Returns:
        The remaining instances, best score first.
    """
    kept: list[int] = []
    for i in sorted(range(len(masks)), key=lambda i: -scores[i]):
        same = [k for k in kept if labels[k] == labels[i]]
        if all(np.count_nonzero(masks[k] & masks[i]) <= MAX_COVERED * np.count_nonzero(masks[i]) for k in same):
            kept.append(i)
    return [masks[i] for i in kept], [labels[i] for i in kept], [scores[i] for i in kept], [boxes[i] for i in kept]


def scored(instances: Instances, threshold: float) -> Instances:
    """Leave out end effectors of a low score.

    Args:
        instances: Instances; of the tools all are kept, because their masks tell about the end effectors'.
        threshold: Least score.

    Returns:
        The remaining instances.
    """
    masks, labels, scores, boxes = instances
    kept = [
        i for i, (label, score) in enumerate(zip(labels, scores, strict=True)) if label == TOOL or score >= threshold
    ]
    return [masks[i] for i in kept], [labels[i] for i in kept], [scores[i] for i in kept], [boxes[i] for i in kept]


def associate(
    masks: list[NDArray[np.bool_]],
    labels: list[int],
    scores: list[float],
    boxes: list[Box],
) -> list[Detection]:
    """Associate end effectors with their tools.

    Args:
        masks: Masks (H, W).
        labels: Class indices; `TOOL` for tools.
        scores: Scores in [0, 1].
        boxes: Boxes [px].

    Returns:
        The end effectors, best score first, each with the tool whose mask covers most of it, if at least
        `MIN_TOOL_OVERLAP`.
    """
    tools = [(m, score) for m, label, score in zip(masks, labels, scores, strict=True) if label == TOOL]
    found = []
    for mask, label, score, box in zip(masks, labels, scores, boxes, strict=True):
        if label == TOOL:
            continue
        overlaps = [float((mask & tool).sum()) / float(mask.sum()) for tool, _ in tools]
        best = int(np.argmax(overlaps)) if overlaps else -1
        tool_mask, tool_score = None, 0.0
        if overlaps and overlaps[best] >= MIN_TOOL_OVERLAP:
            tool_mask, tool_score = tools[best][0] | mask, tools[best][1]
        found.append(Detection(Category(CLASSES[label]), score, mask, box, tool_mask, tool_score))
    return sorted(found, key=lambda d: -d.score)


def mask_iou(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    """Intersection over union of two masks.

    Args:
        a: A mask, (H, W).
        b: The other mask, (H, W).

    Returns:
        Intersection over union in [0, 1]; 0 if both are empty.
    """
    union = int(np.count_nonzero(a | b))
    return int(np.count_nonzero(a & b)) / union if union else 0.0
