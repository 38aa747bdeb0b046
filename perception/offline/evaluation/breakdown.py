"""Accuracy by what a picture shows: occlusion, distance, kind of scene, lens, use of the tool."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from toolee_robot.end_effectors import label_of
from toolee_robot.perception.offline.evaluation import metrics
from toolee_robot.perception.offline.evaluation.estimates import Estimates, asked_for
from toolee_robot.perception.offline.evaluation.records import Instance

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


def held_out_breakdown(instances: list[Instance], estimates: Estimates, of_tool: bool) -> dict[str, Any]:
    """Accuracy of the held-out instances (of all where none is held out) by each of `AXES`.

    Args:
        instances: All instances of the data set.
        estimates: The estimates of those that are asked for.
        of_tool: Whether the estimator is one of whole tools.

    Returns:
        Axis to group to "instances", "left_out" for want of depth, the share with an estimate, and the shares under
        `metrics.THRESHOLDS`. Shares are over all instances of the group, without weights for the categories.
    """
    any_held_out = any(i.held_out and i.target for i in instances)
    asked = [i for i in instances if asked_for(i, of_tool)]
    chosen = np.array([i.held_out or not any_held_out for i in asked], dtype=bool)
    asked, estimates = [i for i, c in zip(asked, chosen, strict=True) if c], estimates.rows(chosen)
    left_out = [i for i in instances if i.too_few_points and (i.held_out or not any_held_out)]
    table: dict[str, Any] = {}
    for axis, group_of in AXES.items():
        groups, dropped = np.array([group_of(i) for i in asked]), [group_of(i) for i in left_out]
        found = {*groups.tolist(), *dropped}
        names = [name for _, name in _BINS.get(axis, ()) if name in found] or sorted(found)
        table[axis] = {name: _row(estimates.rows(groups == name), dropped.count(name)) for name in names}
    return table


def _row(part: Estimates, left_out: int) -> dict[str, Any]:
    shares = metrics.shares(part.angle, part.position) if len(part) else dict.fromkeys(metrics.THRESHOLDS)
    estimated = float(part.made.mean()) if len(part) else None
    return {"instances": len(part), "left_out": left_out, "estimated": estimated, **shares}


def _bin(axis: str, value: float) -> str:
    return next(name for limit, name in _BINS[axis] if value < limit)
