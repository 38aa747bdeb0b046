"""The detector's zoom pass: tools whose end effector it is not sure of, seen larger, each in a crop of its own.

An EE is often 20 px wide. Where it is missed or doubtful the whole tool is mostly found, and says where to look. What
both looks found is one thing; what only one of them saw is half as credible. Also the masks are better: the same
network draws a larger thing more finely, as long as it is no larger than what it was trained on.
Boxes are x0, y0, x1, y1 [px] of the image; sizes are (height, width) [px].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from toolee_robot.perception.detection.detector import TOOL
from toolee_robot.perception.detection.inputs import STRIDE
from toolee_robot.perception.detection.instances import MIN_TOOL_OVERLAP, Box, Instances, mask_iou, without_duplicates
from toolee_robot.types import RgbdFrame

MIN_TOOL_SCORE = 0.3
"""Score from which a tool is worth a zoom pass."""

CERTAIN = 0.9
"""A tool with an EE of this score is not looked at again."""

MAGNIFICATION = 1.6
"""How much larger the zoom pass sees things than the first. At 1.8 and 2 it gains less, though in training things
were enlarged by up to 1.9."""

MIN_MAGNIFICATION = 1.25
"""A tool that fills the image can hardly be enlarged: below this a zoom pass shows nothing new."""

MIN_PROBABILITY = 0.1
"""Class probability from which the zoom pass's detections count: each costs a mask, a tenth of a look, and those below
hardly change a score."""

SAME = 0.5
"""IoU of two masks of one class from which they are of one thing."""

_MARGIN, _MIN_MARGIN = 0.1, 6.0
"""About a tool's box: a share of its longer side, and at least so many pixels."""
_EDGE = 1.5
"""A box that comes so near to a crop's border [px] may be of a thing that goes on beyond it."""

_Instance = tuple[NDArray[np.bool_], int, float, Box]


@dataclass(frozen=True)
class Crop:
    """The part x0 <= x < x1, y0 <= y < y1 [px] of an image, and the size (height, width) at which the network sees
    it."""

    x0: int
    y0: int
    x1: int
    y1: int
    size: tuple[int, int]

    def holds(self, box: Box, image: tuple[int, int]) -> bool:
        """Whether a thing with this box is whole in the crop: clear of those of its borders that are not the image's,
        of (height, width)."""
        return (
            (self.x0 == 0 or box[0] >= self.x0 + _EDGE)
            and (self.y0 == 0 or box[1] >= self.y0 + _EDGE)
            and (self.x1 == image[1] or box[2] <= self.x1 - _EDGE)
            and (self.y1 == image[0] or box[3] <= self.y1 - _EDGE)
        )


def crops(first: Instances, image: tuple[int, int], working: tuple[int, int], pixels: int) -> list[Crop]:
    """A crop about every tool of a first look whose EE is missed or doubtful.

    image: its size; working: the size at which the first look saw it; pixels: what no crop may exceed.
    """
    masks, labels, scores, boxes = first
    certain = [m for m, label, score in zip(masks, labels, scores, strict=True) if label != TOOL and score >= CERTAIN]
    found = []
    for tool, label, score, box in zip(masks, labels, scores, boxes, strict=True):
        if label != TOOL or score < MIN_TOOL_SCORE:
            continue
        if any(np.count_nonzero(m & tool) >= MIN_TOOL_OVERLAP * np.count_nonzero(m) for m in certain):
            continue
        crop = crop_about(box, image, working, pixels)
        if crop is not None:
            found.append(crop)
    return found


def crop_about(box: Box, image: tuple[int, int], working: tuple[int, int], pixels: int) -> Crop | None:
    """The crop that shows `box` with a margin, inside the image, `MAGNIFICATION` times as large as the first look did,
    or less, so that it has at most `pixels`. None where that is under `MIN_MAGNIFICATION`. Arguments as `crops`."""
    margin = max(_MIN_MARGIN, _MARGIN * max(box[2] - box[0], box[3] - box[1]))
    y0, y1, height = _span(box[1] - margin, box[3] + margin, image[0], MAGNIFICATION * working[0] / image[0])
    x0, x1, width = _span(box[0] - margin, box[2] + margin, image[1], MAGNIFICATION * working[1] / image[1])
    shrink = min(1.0, math.sqrt(pixels / (height * width)))
    if MAGNIFICATION * shrink < MIN_MAGNIFICATION:
        return None
    return Crop(x0, y0, x1, y1, (math.floor(height * shrink), math.floor(width * shrink)))


def _span(low: float, high: float, limit: int, scale: float) -> tuple[int, int, int]:
    """Start and end of the part of an axis of `limit` pixels that holds low to high, and how many the network sees of
    it. The network pads to a multiple of STRIDE: rather the scene than padding, where there is more of it."""
    first, last = max(math.floor(low), 0), min(math.ceil(high), limit)
    size = math.ceil((last - first) * scale / STRIDE) * STRIDE
    side = min(math.ceil(size / scale), limit)
    start = min(max((first + last - side) // 2, 0), limit - side)
    return start, start + side, max(1, min(size, round(side * scale)))


def cut(frame: RgbdFrame, crop: Crop) -> RgbdFrame:
    """That part of a frame, with the intrinsics of a camera which sees only it."""
    part = (slice(crop.y0, crop.y1), slice(crop.x0, crop.x1))
    K = frame.intrinsics
    width, height = crop.x1 - crop.x0, crop.y1 - crop.y0
    K = replace(K, cx=K.cx - crop.x0, cy=K.cy - crop.y0, width=width, height=height)
    return RgbdFrame(np.ascontiguousarray(frame.rgb[part]), np.ascontiguousarray(frame.depth[part]), K, frame.stamp)


def placed(seen: Instances, crop: Crop, image: tuple[int, int]) -> Instances:
    """Instances of a crop as those of the image of size (height, width), without what the crop cuts off."""
    kept: list[_Instance] = []
    for mask, label, score, (x0, y0, x1, y1) in zip(*seen, strict=True):
        box = (x0 + crop.x0, y0 + crop.y0, x1 + crop.x0, y1 + crop.y0)
        if crop.holds(box, image):
            whole = np.zeros(image, dtype=np.bool_)
            whole[crop.y0 : crop.y1, crop.x0 : crop.x1] = mask
            kept.append((whole, label, score, box))
    return _columns(kept)


def merge(first: Instances, second: Sequence[Instances], again: Sequence[Crop], image: tuple[int, int]) -> Instances:
    """Both looks in one: a list of instances, in which one thing may still be twice.

    first: of the whole image, of size (height, width); second: `placed`, one for each crop of `again`. What both saw
    has the mean of their scores, and the mask of the second; a tool, of which a crop may show less, that of the better
    score. An EE that one look saw and the other should have has half of its score. What no crop holds stays as it is,
    and so does a tool thin the zoom pass misses; a tool that only it sees is left out.
    """
    # Crops of neighbours share pixels: a thing seen in both counts once.
    together = _columns([instance for look in second for instance in zip(*look, strict=True)])
    later = list(zip(*without_duplicates(*together), strict=True))
    merged: list[_Instance] = []
    for mask, label, score, box in zip(*first, strict=True):
        overlaps = [mask_iou(mask, other[0]) if other[1] == label else 0.0 for other in later]
        best = int(np.argmax(overlaps)) if overlaps else -1
        if overlaps and overlaps[best] >= SAME:
            other_mask, _, other_score, other_box = later.pop(best)
            if label != TOOL or other_score > score:
                mask, box = other_mask, other_box
            score = (score + other_score) / 2
        elif label != TOOL and any(crop.holds(box, image) for crop in again):
            score /= 2
        merged.append((mask, label, score, box))
    merged += [(mask, label, score / 2, box) for mask, label, score, box in later if label != TOOL]
    return _columns(merged)


def _columns(instances: Sequence[_Instance]) -> Instances:
    return (
        [mask for mask, _, _, _ in instances],
        [label for _, label, _, _ in instances],
        [score for _, _, score, _ in instances],
        [box for _, _, _, box in instances],
    )
