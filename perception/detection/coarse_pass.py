"""The coarse pass: a scene that the network sees finer than `MM_PER_PIXEL` is seen a second time at that scale.

Near things and crops fill the network's input: a tool is then larger than the network is surest of. Sizes are
(height, width) [px].
"""

from __future__ import annotations

import math

import numpy as np

from toolee_robot.perception.detection.instances import Instances, mask_iou, without_duplicates
from toolee_robot.perception.detection.zoom_pass import SAME
from toolee_robot.types import RgbdFrame

MM_PER_PIXEL = 1.2
"""Size of a pixel at the scene's median depth [mm] in the coarse pass: the median of end effectors in training."""

MAX_REDUCTION = 0.8
"""Largest factor on height and width: a pass at almost the first one's scale would tell nothing new."""


def coarse_size(frame: RgbdFrame, working: tuple[int, int]) -> tuple[int, int] | None:
    """Size at which the network sees a frame in the coarse pass.

    Args:
        frame: Colour image with registered depth [m].
        working: Size at which the first pass saw it.

    Returns:
        The size; None where the first pass was about as coarse, or no depth is known.
    """
    known = frame.depth[np.isfinite(frame.depth) & (frame.depth > 0)]
    if known.size == 0:
        return None
    height, width = working
    K = frame.intrinsics
    focal = math.sqrt(K.fx * K.fy * (height / K.height) * (width / K.width))
    factor = 1000 * float(np.median(known)) / focal / MM_PER_PIXEL
    if factor > MAX_REDUCTION:
        return None
    return max(1, round(height * factor)), max(1, round(width * factor))


def merge_coarse(found: Instances, coarse: Instances) -> Instances:
    """Merge what the coarse pass detects into what the finer passes do.

    A thing detected by both keeps its mask, which is the finer one, and has the better of the scores.

    Args:
        found: Instances of the passes before.
        coarse: Instances of the coarse pass.

    Returns:
        The merged instances, best score first.
    """
    later = list(zip(*coarse, strict=True))
    merged = []
    for mask, label, score, box in zip(*found, strict=True):
        overlaps = [mask_iou(mask, other[0]) if other[1] == label else 0.0 for other in later]
        best = int(np.argmax(overlaps)) if overlaps else -1
        if overlaps and overlaps[best] >= SAME:
            score = max(score, later.pop(best)[2])
        merged.append((mask, label, score, box))
    merged += later
    return without_duplicates(
        [mask for mask, *_ in merged],
        [label for _, label, *_ in merged],
        [score for *_, score, _ in merged],
        [box for *_, box in merged],
    )
