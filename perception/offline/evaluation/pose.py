"""The metrics of `toolee evaluate pose`, by category and by what a picture shows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolee_robot.end_effectors import CATEGORIES, Category, label_of
from toolee_robot.frames import Array
from toolee_robot.perception.offline.evaluation import metrics
from toolee_robot.perception.offline.evaluation.estimates import Estimates, Ranked
from toolee_robot.perception.offline.evaluation.examples import Instance, ee_shape
from toolee_robot.perception.pose.confidence import RIGHT

GROUPS = ("held-out", "seen")
IOU = 0.1
"""Least box overlap of a detection with its EE (NOCS)."""


def tables(estimates: Estimates) -> dict[str, Any]:
    """The metric table of one estimator with one kind of masks, for held-out and for seen instances.

    Args:
        estimates: Its estimates.

    Returns:
        Group to "table" and "confidence". The table has a row of all metrics for each category that
        occurs, and as "average" the mean over the categories.
    """
    result: dict[str, Any] = {}
    for group, chosen in zip(GROUPS, (estimates.held_out, ~estimates.held_out), strict=True):
        part = estimates.rows(chosen)
        if len(part):
            result[group] = {"table": _table(part), "confidence": confidence(part)}
    return result


def _table(estimates: Estimates) -> dict[str, dict[str, Any]]:
    table = {}
    for i, category in enumerate(CATEGORIES):
        part = estimates.rows(estimates.category == i)
        if len(part):
            table[category.value] = {"instances": len(part), **_row(part)}
    rows = list(table.values())
    average: dict[str, Any] = {"instances": len(estimates)}
    for key in list(rows[0])[1:]:
        known = [r[key] for r in rows if r[key] is not None and np.isfinite(r[key])]
        average[key] = float(np.mean(known)) if known else None
    return {**table, "average": average}


def _row(e: Estimates) -> dict[str, Any]:
    """All metrics of one category.

    Shares under the thresholds, with "paper_" before them by the paper's rule; medians and 95th percentiles of the
    errors; those of the usable estimates, of the EE's origin and of its z axis (a hammer's face: centre and normal).
    """
    made, spin = e.rows(e.made), e.rows(np.isfinite(e.spin))
    usable = e.rows(e.usable & e.made)
    return {
        **metrics.shares(e.angle, e.position),
        **{f"paper_{k}": share for k, share in metrics.shares(e.paper_angle, e.position).items()},
        "estimated": float(e.made.mean()),
        **_quantiles("mm", 1e3 * made.position),
        **_quantiles("deg", np.rad2deg(made.angle)),
        "spin_median_deg": metrics.quantiles(np.rad2deg(spin.spin))["median"],
        "spin_with_hand_median_deg": metrics.quantiles(np.rad2deg(spin.spin_fixed))["median"],
        "usable_share": len(usable) / len(e),
        **_quantiles("mm", 1e3 * usable.position, "usable_centre_"),
        **_quantiles("deg", np.rad2deg(usable.axis), "usable_normal_"),
    }


def _quantiles(unit: str, values: Array, before: str = "") -> dict[str, float | None]:
    return {f"{before}{k}_{unit}": v for k, v in metrics.quantiles(values).items()}


def confidence(e: Estimates) -> dict[str, Any] | None:
    """Calibration and usefulness of the confidence over the estimates that were made.

    Returns:
        The figures; None for an estimator without a confidence.
    """
    made = e.rows(e.made)
    if len(made) < 2 or np.ptp(made.confidence) == 0:
        return None
    success = metrics.within(made.angle, made.position, *metrics.THRESHOLDS["10deg2cm"])
    strict = metrics.within(made.angle, made.position, *metrics.THRESHOLDS["5deg1cm"])
    return {
        "expected_calibration_error": metrics.calibration_error(made.confidence, success),
        "reliability": metrics.reliability(made.confidence, success),
        "usable_share": float(made.usable.mean()),
        "usable_right_10deg2cm": float(success[made.usable].mean()) if made.usable.any() else None,
        "usable_right_5deg1cm": float(strict[made.usable].mean()) if made.usable.any() else None,
    }


def usable_poses(instances: list[Instance], ranked: list[Ranked], images: int) -> dict[str, float | None]:
    """Results of acting on every usable pose, false alarms included.

    Args:
        instances: The instances.
        ranked: The poses.
        images: Number of images.

    Returns:
        Number of poses; share within 10 deg 2 cm of an EE of their category; wrong ones per image; share of the EEs
        asked for that get a right one.
    """
    correct, counts = right_poses(instances, [r for r in ranked if r.usable])
    right, counted = int(correct.sum()), int(counts.sum())
    targets = sum(i.target for i in instances)
    return {
        "poses": counted,
        "right_10deg2cm": right / counted if counted else None,
        "wrong_per_image": (counted - right) / images if images else None,
        "found_10deg2cm": right / targets if targets else None,
    }


def right_poses(instances: list[Instance], ranked: list[Ranked]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """The criterion by which poses under a detector's masks are reported and trust in them is fitted.

    Args:
        instances: What there is in the images.
        ranked: Poses of any images and categories, in any order.

    Returns:
        For each pose whether it is within `confidence.RIGHT` of an end effector of its category that no pose of a
        higher score has taken, and whether it counts at all: one of an end effector that is not asked for does not.
    """
    by_image = _by_image(instances)
    order = sorted(range(len(ranked)), key=lambda k: -ranked[k].score)
    best_first = [ranked[k] for k in order]
    overlaps = [_overlaps(r, by_image.get((r.image, r.category), [])) for r in best_first]
    correct, counted = _matched(best_first, overlaps)
    place = np.argsort(order)
    return correct[place], counted[place]


_Overlap = list[tuple[float, Instance]]


def _by_image(instances: list[Instance]) -> dict[tuple[int, Category], list[Instance]]:
    found: dict[tuple[int, Category], list[Instance]] = {}
    for instance in instances:
        found.setdefault((instance.image, instance.category), []).append(instance)
    return found


def _overlaps(detection: Ranked, instances: list[Instance]) -> _Overlap:
    """Instances that a detection may belong to, the best overlap first."""
    found = []
    for instance in instances:
        distance = float(np.linalg.norm(detection.X_camera_ee[:3, 3] - instance.X_camera_ee[:3, 3]))
        shape = ee_shape(instance.catalogue, instance.tool, instance.ee)
        if distance > 2 * shape.diameter:
            continue
        group = instance.category.symmetry
        iou = metrics.box_iou(detection.X_camera_ee, instance.X_camera_ee, shape.low, shape.high, group)
        if iou > IOU:
            found.append((iou, instance))
    return sorted(found, key=lambda pair: -pair[0])


def _matched(ranked: list[Ranked], overlaps: list[_Overlap]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which detections, best score first, are right, and which count (those of hardly visible EEs do not)."""
    correct, counted = np.zeros(len(ranked), dtype=bool), np.ones(len(ranked), dtype=bool)
    taken: set[int] = set()
    for k, (detection, candidates) in enumerate(zip(ranked, overlaps, strict=True)):
        for _, instance in candidates:
            if id(instance) in taken:
                continue
            if not instance.target:
                counted[k] = False
                break
            X, X_true = detection.X_camera_ee, instance.X_camera_ee
            angle = instance.category.symmetry.rotation_error(X[:3, :3], X_true[:3, :3])
            distance = np.linalg.norm(X[:3, 3] - X_true[:3, 3])
            if bool(metrics.within(np.asarray(angle), np.asarray(distance), *RIGHT)):
                correct[k] = True
                taken.add(id(instance))
                break
    return correct, counted


def latency(estimates: Estimates) -> dict[str, float | None]:
    """Wall-clock time of an estimate (encoder, sampling, pooling), without the first five calls."""
    ms = estimates.ms[estimates.made][5:]
    if len(ms) == 0:
        return {"median_ms": None, "p90_ms": None}
    return {"median_ms": float(np.median(ms)), "p90_ms": float(np.percentile(ms, 90))}


_BINS = {
    "occlusion": ((0.02, "under 2 %"), (0.20, "2 to 20 %"), (0.40, "20 to 40 %"), (1.01, "40 to 70 %")),
    "distance": (
        (0.55, "0.40 to 0.55 m"),
        (0.70, "0.55 to 0.70 m"),
        (0.85, "0.70 to 0.85 m"),
        (9.0, "0.85 to 1.10 m"),
    ),
    "f / width": ((0.69, "under 0.69"), (0.745, "0.69 to 0.745"), (1.0, "0.745 to 1.0"), (9.0, "over 1.0")),
}
AXES: dict[str, Callable[[Instance], str]] = {
    "occlusion": lambda i: _bin("occlusion", i.occlusion),
    "distance": lambda i: _bin("distance", float(i.X_camera_ee[2, 3])),
    "scene": lambda i: i.scene,
    "f / width": lambda i: _bin("f / width", i.intrinsics.fx / i.intrinsics.width),
    "category": lambda i: label_of(i.category.value),
    "tool": lambda i: i.role,
}
"""What the end effectors are grouped by. Of the sensor the data set records the lens only, the focal length in image
widths (a Kinect v2's is 0.714), not what its noise model drew."""


def held_out_breakdown(instances: list[Instance], estimates: Estimates) -> dict[str, Any]:
    """Accuracy of the held-out instances (of all where none is held out) by each of `AXES`.

    Args:
        instances: All instances of the data set.
        estimates: The estimates of those that are asked for.

    Returns:
        Axis to group to "instances", "left_out" for want of depth, the share with an estimate, and the shares under
        `metrics.THRESHOLDS`. Shares are over all instances of the group, without weights for the categories.
    """
    any_held_out = any(i.held_out and i.target for i in instances)
    asked = [i for i in instances if i.target]
    chosen = np.array([i.held_out or not any_held_out for i in asked], dtype=bool)
    asked, estimates = [i for i, c in zip(asked, chosen, strict=True) if c], estimates.rows(chosen)
    left_out = [i for i in instances if i.too_few_points and (i.held_out or not any_held_out)]
    table: dict[str, Any] = {}
    for axis, group_of in AXES.items():
        groups, dropped = np.array([group_of(i) for i in asked]), [group_of(i) for i in left_out]
        found = {*groups.tolist(), *dropped}
        names = [name for _, name in _BINS.get(axis, ()) if name in found] or sorted(found)
        table[axis] = {name: _share_row(estimates.rows(groups == name), dropped.count(name)) for name in names}
    return table


def _share_row(part: Estimates, left_out: int) -> dict[str, Any]:
    shares = metrics.shares(part.angle, part.position) if len(part) else dict.fromkeys(metrics.THRESHOLDS)
    estimated = float(part.made.mean()) if len(part) else None
    return {"instances": len(part), "left_out": left_out, "estimated": estimated, **shares}


def _bin(axis: str, value: float) -> str:
    return next(name for limit, name in _BINS[axis] if value < limit)
