"""Passes of the detector over parts of a frame. Boxes are x0, y0, x1, y1 [px] of the image; sizes (height, width) [px].

Coarse: a scene that the network sees finer than `MM_PER_PIXEL` is seen a second time at that scale. Near things and
crops fill the network's input: a tool is then larger than the network is surest of.

Hand: the part of an image in which a held tool can be, from the hand's pose. In a job the arm's kinematics and the
camera's calibration give X_camera_hand, and nothing but the tool in the hand is of interest: the rest of the image
costs time and adds what may be mistaken for it.

Zoom: tools whose end effector is missing or doubtful are detected again in an enlarged crop. An EE is often only 20 px
wide. Where it is missed, its whole tool is mostly detected and shows where to look. A thing detected in both passes
keeps one instance; one detected in only one of them has half its score. Masks improve as well: the network segments
enlarged things more finely, up to the sizes it was trained on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.frames import Array, transform_points
from toolee_robot.perception.detection.detector import TOOL
from toolee_robot.perception.detection.inputs import MAX_ENLARGEMENT, STRIDE
from toolee_robot.perception.detection.instances import MIN_TOOL_OVERLAP, Box, Instance, mask_iou, without_duplicates
from toolee_robot.types import CameraIntrinsics, HeldRegion, RgbdFrame

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


def merge_coarse(found: Sequence[Instance], coarse: Sequence[Instance]) -> list[Instance]:
    """Merge what the coarse pass detects into what the finer passes do.

    A thing detected by both keeps its mask, which is the finer one, and has the better of the scores.

    Args:
        found: Instances of the passes before.
        coarse: Instances of the coarse pass.

    Returns:
        The merged instances, best score first.
    """
    later, merged = list(coarse), []
    for one in found:
        if (other := _same_as(one, later)) is not None:
            one = one._replace(score=max(one.score, later.pop(other).score))
        merged.append(one)
    return without_duplicates([*merged, *later])


def _same_as(one: Instance, others: Sequence[Instance]) -> int | None:
    """Index of the instance that is of the same thing."""
    overlaps = [mask_iou(one.mask, other.mask) if other.label == one.label else 0.0 for other in others]
    best = int(np.argmax(overlaps)) if overlaps else -1
    return best if overlaps and overlaps[best] >= SAME else None


PIXELS = 320 * 320
"""Area [px] at which the network sees the crop."""


def hand_crop(
    X_camera_hand: Array, region: HeldRegion, intrinsics: CameraIntrinsics, pixels: int = PIXELS
) -> Crop | None:
    """The crop that holds everything a camera can see of a region fixed to the hand.

    Args:
        X_camera_hand: Pose of the hand in the camera's frame, (4, 4).
        region: The region.
        intrinsics: Pinhole model of the image.
        pixels: Area at which the network sees the crop [px]; it is enlarged by at most `MAX_ENLARGEMENT`.

    Returns:
        The crop; None where the region is outside of the image.
    """
    centers = transform_points(X_camera_hand, region.points)
    K = intrinsics
    x0, x1 = _extent(centers[:, 0], centers[:, 2], region.radius)
    y0, y1 = _extent(centers[:, 1], centers[:, 2], region.radius)
    # Pixel centres are at integer coordinates: the pixel u covers u - 0.5 to u + 0.5.
    left, right = (min(max(K.fx * x + K.cx + 0.5, 0.0), float(K.width)) for x in (x0, x1))
    top, bottom = (min(max(K.fy * y + K.cy + 0.5, 0.0), float(K.height)) for y in (y0, y1))
    if right - left < 1.0 or bottom - top < 1.0 or centers[:, 2].max() + region.radius <= 0.0:
        return None
    scale = min(MAX_ENLARGEMENT, math.sqrt(pixels / ((right - left) * (bottom - top))))
    first_row, last_row, height = span(top, bottom, K.height, scale)
    first_column, last_column, width = span(left, right, K.width, scale)
    return Crop(first_column, first_row, last_column, last_row, (height, width))


def _extent(across: Array, z: Array, radius: float) -> tuple[float, float]:
    """Least and largest slope across / z over discs of one radius in the plane of one image axis and the optical axis.

    A line from the camera's centre with the slope t is tangent to a disc where
    (z^2 - r^2) t^2 - 2 a z t + a^2 - r^2 = 0.

    Args:
        across: Places of the discs' centres along the image axis, (N,) [m].
        z: Their depths, (N,) [m].
        radius: Radius of the discs [m].

    Returns:
        The slopes; infinite where a disc reaches the plane of the camera.
    """
    if (z <= radius).any():
        return -math.inf, math.inf
    root = radius * np.sqrt(across**2 + z**2 - radius**2)
    denominator = z**2 - radius**2
    return float(((across * z - root) / denominator).min()), float(((across * z + root) / denominator).max())


MIN_TOOL_SCORE = 0.3
"""Least score of a tool for a zoom pass."""

CERTAIN = 0.9
"""A tool with an EE of at least this score needs no zoom pass."""

MAGNIFICATION = 1.6
"""Magnification relative to the first pass. 1.8 and 2 gain less, although training images are enlarged by up to 1.9."""

MIN_MAGNIFICATION = 1.25
"""Least magnification for a zoom pass: a tool that fills the image can hardly be enlarged."""

MIN_PROBABILITY = 0.1
"""Least class probability in a crop: each detection costs a mask (a tenth of a pass), and weaker ones hardly change a
score.
"""

SAME = 0.5
"""Masks of one class with at least this IoU are of one thing."""

_MARGIN, _MIN_MARGIN = 0.1, 6.0
"""Margin around a tool's box: a share of its longer side, and at least so many pixels."""
_EDGE = 1.5
"""A box this near [px] to a crop's border may be of a thing that continues beyond it."""


@dataclass(frozen=True)
class Crop:
    """A part of an image, seen enlarged.

    Attributes:
        x0: First column [px].
        y0: First row [px].
        x1: Column after the last [px].
        y1: Row after the last [px].
        size: Size (height, width) [px] at which the network sees it.
    """

    x0: int
    y0: int
    x1: int
    y1: int
    size: tuple[int, int]

    def holds(self, box: Box, image: tuple[int, int]) -> bool:
        """Whether a thing lies entirely inside of the crop.

        Args:
            box: Its box in the image [px].
            image: Size (height, width) [px] of the image.

        Returns:
            True if the box is clear of those borders of the crop that are not the image's.
        """
        return (
            (self.x0 == 0 or box[0] >= self.x0 + _EDGE)
            and (self.y0 == 0 or box[1] >= self.y0 + _EDGE)
            and (self.x1 == image[1] or box[2] <= self.x1 - _EDGE)
            and (self.y1 == image[0] or box[3] <= self.y1 - _EDGE)
        )


def crops(first: Sequence[Instance], image: tuple[int, int], working: tuple[int, int], pixels: int) -> list[Crop]:
    """The crops around the tools whose EE is missing or doubtful.

    Args:
        first: Instances of the first pass.
        image: Size (height, width) [px] of the image.
        working: Size at which the first pass saw it.
        pixels: Largest area of a crop as the network sees it [px].

    Returns:
        One crop per such tool that can be enlarged enough.
    """
    certain = [i.mask for i in first if i.label != TOOL and i.score >= CERTAIN]
    found = []
    for tool in (i for i in first if i.label == TOOL and i.score >= MIN_TOOL_SCORE):
        if any(np.count_nonzero(m & tool.mask) >= MIN_TOOL_OVERLAP * np.count_nonzero(m) for m in certain):
            continue
        crop = crop_about(tool.box, image, working, pixels)
        if crop is not None:
            found.append(crop)
    return found


def crop_about(box: Box, image: tuple[int, int], working: tuple[int, int], pixels: int) -> Crop | None:
    """The crop around one box, with a margin, inside of the image.

    Args:
        box: Box [px] to show.
        image: See `crops`.
        working: See `crops`.
        pixels: See `crops`.

    Returns:
        The crop, enlarged by `MAGNIFICATION` or by less to keep within `pixels`; None where that is under
        `MIN_MAGNIFICATION`.
    """
    margin = max(_MIN_MARGIN, _MARGIN * max(box[2] - box[0], box[3] - box[1]))
    y0, y1, height = span(box[1] - margin, box[3] + margin, image[0], MAGNIFICATION * working[0] / image[0])
    x0, x1, width = span(box[0] - margin, box[2] + margin, image[1], MAGNIFICATION * working[1] / image[1])
    shrink = min(1.0, math.sqrt(pixels / (height * width)))
    if MAGNIFICATION * shrink < MIN_MAGNIFICATION:
        return None
    return Crop(x0, y0, x1, y1, (math.floor(height * shrink), math.floor(width * shrink)))


def span(low: float, high: float, limit: int, scale: float) -> tuple[int, int, int]:
    """The part of an axis that a crop takes.

    The network pads to a multiple of STRIDE, so that the part is widened to one where the image allows.

    Args:
        low: Least place [px] that it must hold.
        high: Largest place [px] that it must hold.
        limit: Size of the image along the axis [px].
        scale: Pixels of the network's input a pixel of the image.

    Returns:
        First pixel, pixel after the last, and size [px] at which the network sees the part.
    """
    first, last = max(math.floor(low), 0), min(math.ceil(high), limit)
    size = math.ceil((last - first) * scale / STRIDE) * STRIDE
    side = min(math.ceil(size / scale), limit)
    start = min(max((first + last - side) // 2, 0), limit - side)
    return start, start + side, max(1, min(size, round(side * scale)))


def cut(frame: RgbdFrame, crop: Crop) -> RgbdFrame:
    """Cut a crop out of a frame, with the intrinsics of a camera that sees only that part.

    Args:
        frame: The frame.
        crop: The part of it.

    Returns:
        The part as a frame of its own, with the same camera frame and stamp.
    """
    part = (slice(crop.y0, crop.y1), slice(crop.x0, crop.x1))
    K = frame.intrinsics
    width, height = crop.x1 - crop.x0, crop.y1 - crop.y0
    K = replace(K, cx=K.cx - crop.x0, cy=K.cy - crop.y0, width=width, height=height)
    return RgbdFrame(np.ascontiguousarray(frame.rgb[part]), np.ascontiguousarray(frame.depth[part]), K, frame.stamp)


def placed(
    seen: Sequence[Instance], crop: Crop, image: tuple[int, int], *, tools_cut_off: bool = False
) -> list[Instance]:
    """Instances of a crop in the coordinates of the image.

    Args:
        seen: Instances in the crop.
        crop: The crop.
        image: Size (height, width) [px] of the image.
        tools_cut_off: Whether to keep tools that the crop cuts off.

    Returns:
        The instances in the image, without those that the crop cuts off.
    """
    kept = []
    for one in seen:
        x0, y0, x1, y1 = one.box
        box = (x0 + crop.x0, y0 + crop.y0, x1 + crop.x0, y1 + crop.y0)
        if crop.holds(box, image) or (tools_cut_off and one.label == TOOL):
            whole = np.zeros(image, dtype=np.bool_)
            whole[crop.y0 : crop.y1, crop.x0 : crop.x1] = one.mask
            kept.append(one._replace(mask=whole, box=box))
    return kept


def merge(
    first: Sequence[Instance], second: Sequence[Sequence[Instance]], zoomed: Sequence[Crop], image: tuple[int, int]
) -> list[Instance]:
    """Merge the instances of both passes; a thing may still be in the result twice.

    A thing detected in both passes has the mean of the scores and the second pass's mask (a tool, of which a crop may
    show less, the mask of the better score). An EE detected in only one pass where the other covers it has half of its
    score. Things outside of every crop, and tools that the zoom pass misses, stay unchanged; tools detected only in the
    zoom pass are dropped.

    Args:
        first: Instances of the whole image.
        second: `placed` instances of each crop.
        zoomed: The crops.
        image: Size (height, width) [px] of the image.

    Returns:
        The merged instances.
    """
    # Crops of neighbours share pixels: a thing seen in both counts once.
    later = without_duplicates([one for seen in second for one in seen])
    merged = []
    for one in first:
        if (other := _same_as(one, later)) is not None:
            again = later.pop(other)
            better = again if one.label != TOOL or again.score > one.score else one
            one = better._replace(score=(one.score + again.score) / 2)
        elif one.label != TOOL and any(crop.holds(one.box, image) for crop in zoomed):
            one = one._replace(score=one.score / 2)
        merged.append(one)
    return [*merged, *(one._replace(score=one.score / 2) for one in later if one.label != TOOL)]
