"""The detector and the whole estimator on real RGB-D frames: `toolee evaluate photographs`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from toolee_robot.perception.detection.boxes import pairwise_iou
from toolee_robot.perception.offline.annotation.poses import Box, position_sigma, rotation_sigma
from toolee_robot.perception.offline.evaluation.photographs import HALVES, End, Photograph, crops
from toolee_robot.perception.pipeline import ToolPerception
from toolee_robot.types import ToolEstimate

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
