"""Instances of one image: duplicates removed, end effectors associated with their tools."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

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


class Instance(NamedTuple):
    """A thing that is seen in an image.

    Attributes:
        mask: Its pixels, (H, W) in the image's own size.
        label: Class index; `TOOL` for a tool.
        score: Score in [0, 1].
        box: Its box [px].
    """

    mask: NDArray[np.bool_]
    label: int
    score: float
    box: Box


def without_duplicates(instances: Sequence[Instance]) -> list[Instance]:
    """Remove instances that a better one of the same class mostly covers.

    By masks, because the boxes of a slanting, thin object detected twice hardly overlap.

    Args:
        instances: Instances of one image.

    Returns:
        The remaining instances, best score first.
    """
    kept: list[Instance] = []
    for one in sorted(instances, key=lambda i: -i.score):
        same = [k for k in kept if k.label == one.label]
        if all(np.count_nonzero(k.mask & one.mask) <= MAX_COVERED * np.count_nonzero(one.mask) for k in same):
            kept.append(one)
    return kept


def associate(instances: Sequence[Instance]) -> list[Detection]:
    """Associate end effectors with their tools.

    Args:
        instances: Instances of one image.

    Returns:
        The end effectors, best score first, each with the tool whose mask covers most of it, if at least
        `MIN_TOOL_OVERLAP`.
    """
    tools = [i for i in instances if i.label == TOOL]
    found = []
    for mask, label, score, box in (i for i in instances if i.label != TOOL):
        overlaps = [float((mask & tool.mask).sum()) / float(mask.sum()) for tool in tools]
        best = int(np.argmax(overlaps)) if overlaps else -1
        tool_mask, tool_score = None, 0.0
        if overlaps and overlaps[best] >= MIN_TOOL_OVERLAP:
            tool_mask, tool_score = tools[best].mask | mask, tools[best].score
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
