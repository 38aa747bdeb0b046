"""Sets of real RGB-D frames, and their scores: `toolee evaluate photographs`.

A set is a folder with `frames.json` and the pictures that it names. Of a frame it has colour, registered depth,
intrinsics, the place where it was taken and the half of the set that it belongs to: one half to choose by, the other
to report; frames of neither, whose pictures were trained on, are not scored. Ends have a category, a box [px] and,
where it is known, a pose; ranges to ignore hold what is neither found nor a false alarm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError, words_of
from toolee_robot.frames import Array
from toolee_robot.perception.detection.boxes import pairwise_iou
from toolee_robot.perception.io import make_intrinsics, read_depth, read_rgb
from toolee_robot.perception.offline.annotation.poses import Box, position_sigma, rotation_sigma
from toolee_robot.perception.pipeline import ToolPerception
from toolee_robot.runtime.files import read_json
from toolee_robot.types import CameraIntrinsics, RgbdFrame, ToolEstimate

HALVES = ("A", "B")
"""The halves of a set: A to choose by, B to report."""


@dataclass(frozen=True)
class End:
    """An annotated end effector.

    Attributes:
        category: Its category.
        box: Box of its visible part, x0, y0, x1, y1 [px].
        X_camera_ee: Its pose, 4x4; None where it is not known.
        covariance: The pose's covariance, 6x6: position [m], rotation vector [rad], in the camera's axes; None where it
            is not known.
    """

    category: Category
    box: Box
    X_camera_ee: Array | None
    covariance: Array | None = None


@dataclass(frozen=True)
class Photograph:
    """An annotated frame.

    Attributes:
        name: Its name in the set.
        place: Where it was taken.
        half: The half of the set, one of HALVES.
        depth_is: "measured" by a sensor, or "modelled" from the geometry of a calibrated scene.
        frame: Colour and depth [m].
        ends: The end effectors in view.
        ignore: Boxes [px] in which a detection does not count.
    """

    name: str
    place: str
    half: str
    depth_is: str
    frame: RgbdFrame
    ends: tuple[End, ...]
    ignore: tuple[Box, ...]


def read_photographs(folder: Path, limit: int | None = None) -> list[Photograph]:
    """Read a set.

    Args:
        folder: Its folder.
        limit: Largest number of frames of each place.

    Returns:
        Its frames in the order of the file, without those of no half.

    Raises:
        UserError: `frames.json` or a picture is missing or damaged; the message names it.
    """
    path = folder / "frames.json"
    try:
        entries = read_json(path)["frames"]
        places: dict[str, int] = {}
        found = []
        for entry in entries:
            if entry["half"] not in HALVES:
                continue
            places[entry["place"]] = places.get(entry["place"], 0) + 1
            if limit is None or places[entry["place"]] <= limit:
                found.append(_photograph(folder, entry))
        return found
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise UserError(
            f"{path} is not a set of photographs ({words_of(error)}): make one as docs/dataset.md says",
            code="user.photographs",
        ) from error


def _photograph(folder: Path, entry: dict[str, Any]) -> Photograph:
    rgb = read_rgb(folder / entry["rgb"])
    height, width = rgb.shape[:2]
    fx, fy, cx, cy = (float(v) for v in entry["intrinsics"])
    depth = read_depth(folder / entry["depth"], 0.001 * float(entry.get("depth_scale", 1.0)))
    frame = RgbdFrame(rgb, depth, make_intrinsics(fx, fy, cx, cy, width, height))
    ends = tuple(
        End(Category(e["category"]), _box(e["box"]), _matrix(e, "X_camera_ee", 4), _matrix(e, "covariance", 6))
        for e in entry["ends"]
    )
    ignore = tuple(_box(b) for b in entry["ignore"])
    return Photograph(entry["name"], entry["place"], entry["half"], entry["depth_is"], frame, ends, ignore)


def _matrix(entry: dict[str, Any], key: str, size: int) -> Array | None:
    return None if entry.get(key) is None else np.array(entry[key], dtype=np.float64).reshape(size, size)


def _box(values: Sequence[float]) -> Box:
    x0, y0, x1, y1 = (float(v) for v in values)
    return x0, y0, x1, y1


def crops(photograph: Photograph) -> list[Photograph]:
    """Crops of half the width and height about each end, as an operator would cut them.

    Args:
        photograph: A whole frame.

    Returns:
        One photograph per end, with that end alone annotated; other ends in the crop are ignored.
    """
    height, width = photograph.frame.depth.shape
    h, w = height // 2, width // 2
    made = []
    for k, end in enumerate(photograph.ends):
        x = int(np.clip((end.box[0] + end.box[2]) / 2 - w / 2, 0, width - w))
        y = int(np.clip((end.box[1] + end.box[3]) / 2 - h / 2, 0, height - h))
        K = photograph.frame.intrinsics
        inside = CameraIntrinsics(K.fx, K.fy, float(np.clip(K.cx - x, 0, w)), float(np.clip(K.cy - y, 0, h)), w, h)
        part = np.s_[y : y + h, x : x + w]
        frame = RgbdFrame(photograph.frame.rgb[part].copy(), photograph.frame.depth[part].copy(), inside)
        others = [e.box for j, e in enumerate(photograph.ends) if j != k]
        # The principal point of a crop may lie outside of it, which the pose cannot take: poses are not judged here.
        ends = (End(end.category, _moved(end.box, x, y), None),)
        ignore = tuple(_moved(b, x, y) for b in [*photograph.ignore, *others])
        name, about = f"{photograph.name}#{k}", (photograph.place, photograph.half, photograph.depth_is)
        made.append(Photograph(name, *about, frame, ends, ignore))
    return made


def _moved(box: Box, x: float, y: float) -> Box:
    return box[0] - x, box[1] - y, box[2] - x, box[3] - y


VIEWS = ("whole", "crop")
"""Whole frames; crops of half a frame's width and height about each end."""
CERTAIN = 0.5
"""Score from which a detection is called certain in the report."""
MIN_IOU = 0.5
"""Least IoU of a detection's box with the annotated one."""
MAX_DISTANCE, MAX_ANGLE = 0.02, np.deg2rad(10)
"""Errors up to which a pose is right [m, rad]."""
DOUBT = 2.0
"""A verdict within so many of the annotation's standard deviations of the bounds is not decided."""
MEASURES = ("mm", "deg", "annotation_mm", "annotation_deg")
"""Errors of the estimates, and standard deviations of the annotations."""


def evaluate(
    perception: ToolPerception,
    photographs: Sequence[Photograph],
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Score the perception on photographs.

    Args:
        perception: Detector and estimator.
        photographs: The frames.
        progress: Called with the numbers of finished and of all frames.

    Returns:
        "ends": one record per annotated end and view; "frames": one per frame; "table": figures by half and view, see
        `summary`; "places": the false alarms by place.
    """
    ends: list[dict[str, Any]] = []
    frames: list[dict[str, Any]] = []
    for n, photograph in enumerate(photographs):
        estimates = perception.estimate(photograph.frame)
        ends += _ends(photograph, estimates, "whole")
        frames.append(_alarms(photograph, estimates))
        for crop in crops(photograph):
            ends += _ends(crop, perception.estimate(crop.frame), "crop")
        if progress is not None:
            progress(n + 1, len(photographs))
    table = [summary(ends, frames, half, view) for half in HALVES for view in VIEWS]
    names = sorted({f["place"] for f in frames})
    places = [summary(ends, frames, None, "whole", place) for place in names]
    return {"table": table, "places": places, "ends": ends, "frames": frames}


def summary(
    ends: Sequence[dict[str, Any]],
    frames: Sequence[dict[str, Any]],
    half: str | None,
    view: str,
    place: str | None = None,
) -> dict[str, Any]:
    """Figures of one half, view or place.

    Args:
        ends: Records of ends.
        frames: Records of frames.
        half: A half of the set; None: both.
        view: One of VIEWS; false alarms are those of whole frames.
        place: A place; None: all.

    Returns:
        Number of ends, how many are found at the operating score and from CERTAIN on, the median score of the best
        detection (0 where there is none), how many have a usable estimate, how many of those with a known pose a
        right one, and of how many the annotation is too uncertain to say (see `decided`); their median errors, and
        the median standard deviations of their annotation; frames without an end, their false alarms at both scores,
        and how many give a usable estimate.
    """

    def chosen(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        return [r for r in rows if half in (None, r["half"]) and place in (None, r["place"])]

    asked = [r for r in chosen(ends) if r["view"] == view]
    empty = [r for r in chosen(frames) if not r["ends"]]
    posed = [r for r in asked if r["right"] is not None]
    return {
        "half": half,
        "view": view,
        "place": place,
        "ends": len(asked),
        "found": sum(r["score"] > 0 for r in asked),
        "certain": sum(r["score"] >= CERTAIN for r in asked),
        "median_score": round(float(np.median([r["score"] for r in asked])), 3) if asked else None,
        "usable": sum(r["usable"] for r in asked),
        "known_poses": len(posed),
        "right": sum(r["right"] for r in posed),
        "undecided": sum(r["decided"] is False for r in posed),
        **{f"median_{k}": _median([r[k] for r in posed if r[k] is not None]) for k in MEASURES},
        "empty_frames": len(empty),
        "false_alarms": sum(r["detections"] for r in empty),
        "certain_false_alarms": sum(r["certain"] for r in empty),
        "frames_with_usable_alarm": sum(r["usable"] > 0 for r in empty),
    }


def _median(values: Sequence[float]) -> float | None:
    return round(float(np.median(values)), 2) if values else None


def _ends(photograph: Photograph, estimates: Sequence[ToolEstimate], view: str) -> list[dict[str, Any]]:
    """A record per annotated end: its best detection of the right category."""
    records = []
    for end in photograph.ends:
        good = [e for e in estimates if e.category == end.category and _iou(e.detection.box, end.box) >= MIN_IOU]
        best = max(good, key=lambda e: e.detection.score, default=None)
        fields: dict[str, Any] = {"name": photograph.name, "place": photograph.place, "half": photograph.half}
        fields |= {"view": view, "category": str(end.category), "score": 0.0, "usable": False, "right": None}
        if end.X_camera_ee is not None:
            fields |= {"right": False, "mm": None, "deg": None, "decided": None, **_annotation(end)}
        if best is not None:
            fields |= {"score": round(best.detection.score, 4), "usable": best.usable}
        if best is not None and end.X_camera_ee is not None and np.isfinite(best.X_camera_ee).all():
            distance = float(np.linalg.norm(best.X_camera_ee[:3, 3] - end.X_camera_ee[:3, 3]))
            angle = end.category.symmetry.rotation_error(best.X_camera_ee[:3, :3], end.X_camera_ee[:3, :3])
            fields |= {"mm": round(1000 * distance, 2), "deg": round(float(np.rad2deg(angle)), 2)}
            fields["right"] = bool(distance <= MAX_DISTANCE and angle <= MAX_ANGLE)
            fields["decided"] = decided(fields, distance, angle)
        records.append(fields)
    return records


def _annotation(end: End) -> dict[str, float | None]:
    """Standard deviations of an annotated pose, where they are known."""
    if end.X_camera_ee is None or end.covariance is None:
        return {"annotation_mm": None, "annotation_deg": None}
    turn = rotation_sigma(end.category, end.X_camera_ee, end.covariance)
    return {
        "annotation_mm": round(1000 * position_sigma(end.covariance), 2),
        "annotation_deg": round(float(np.rad2deg(turn)), 2),
    }


def decided(record: dict[str, Any], distance: float, angle: float) -> bool | None:
    """Whether a verdict would be the same were the annotation off by DOUBT standard deviations.

    Args:
        record: The end's `annotation_mm` and `annotation_deg`.
        distance: The estimate's distance from the annotation [m].
        angle: Its angle from the annotation modulo the symmetry [rad].

    Returns:
        Whether it would; None where the annotation's uncertainty is not known.
    """
    if record["annotation_mm"] is None:
        return None
    beyond = [
        (distance - MAX_DISTANCE) / (1e-3 * record["annotation_mm"]),
        (angle - MAX_ANGLE) / np.deg2rad(record["annotation_deg"]),
    ]
    return bool(max(beyond) > DOUBT or max(beyond) < -DOUBT)


def _alarms(photograph: Photograph, estimates: Sequence[ToolEstimate]) -> dict[str, Any]:
    """A record of a whole frame: the detections that belong to no annotated end and no ignored range."""
    boxes = [*photograph.ignore, *[e.box for e in photograph.ends]]
    alarms = [e for e in estimates if not any(_overlap(e.detection.box, b) > 0.5 for b in boxes)]
    return {
        "name": photograph.name,
        "place": photograph.place,
        "half": photograph.half,
        "ends": len(photograph.ends),
        "detections": len(alarms),
        "certain": sum(e.detection.score >= CERTAIN for e in alarms),
        "usable": sum(e.usable for e in alarms),
        "categories": sorted(str(e.category) for e in alarms if e.usable),
    }


def _overlap(a: Box, b: Box) -> float:
    """Share of box `a` that lies in box `b`."""
    w, h = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    area = (a[2] - a[0]) * (a[3] - a[1])
    return w * h / area if w > 0 and h > 0 and area > 0 else 0.0


def _iou(a: Sequence[float], b: Box) -> float:
    return float(pairwise_iou(torch.tensor([a]), torch.tensor([b])))
