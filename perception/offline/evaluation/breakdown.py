"""Accuracy by what a picture shows: occlusion, distance, kind of scene, lens, use of the tool."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from toolee_robot.end_effectors import label_of
from toolee_robot.perception.offline.evaluation import metrics
from toolee_robot.perception.offline.evaluation.estimates import Estimates, asked_for
from toolee_robot.perception.offline.evaluation.records import Instance

_OCCLUSION = ((0.02, "under 2 %"), (0.20, "2 to 20 %"), (0.40, "20 to 40 %"), (1.01, "40 to 70 %"))
_DISTANCE = ((0.55, "0.40 to 0.55 m"), (0.70, "0.55 to 0.70 m"), (0.85, "0.70 to 0.85 m"), (9.0, "0.85 to 1.10 m"))
_FOCAL = ((0.69, "under 0.69"), (0.745, "0.69 to 0.745"), (1.0, "0.745 to 1.0"), (9.0, "over 1.0"))

AXES: dict[str, Callable[[Instance], str]] = {
    "occlusion": lambda i: _bin(i.occlusion, _OCCLUSION),
    "distance": lambda i: _bin(float(i.X_camera_ee[2, 3]), _DISTANCE),
    "scene": lambda i: i.scene,
    "f / width": lambda i: _bin(i.intrinsics.fx / i.intrinsics.width, _FOCAL),
    "category": lambda i: label_of(i.category.value),
    "tool": lambda i: i.role,
}
"""What the end effectors are grouped by. Of the sensor the data set records the lens only, the focal length in image
widths (a Kinect v2's is 0.714), not what its noise model drew."""


def held_out_breakdown(instances: list[Instance], estimates: Estimates, of_tool: bool) -> dict[str, Any]:
    """The breakdown of the held-out instances; of all where none is held out.

    Args:
        instances: All instances of the data set.
        estimates: The estimates of those that are asked for.
        of_tool: Whether the estimator is one of whole tools.

    Returns:
        See `breakdown`.
    """
    any_held_out = any(i.held_out and i.target for i in instances)
    asked = [i for i in instances if asked_for(i, of_tool)]
    chosen = np.array([i.held_out or not any_held_out for i in asked], dtype=bool)
    left_out = [i for i in instances if i.too_few_points and (i.held_out or not any_held_out)]
    return breakdown([i for i, c in zip(asked, chosen, strict=True) if c], left_out, estimates.rows(chosen))


def breakdown(asked: list[Instance], left_out: list[Instance], estimates: Estimates) -> dict[str, Any]:
    """Accuracy by each of `AXES`.

    Args:
        asked: The instances that are asked for, in the order of the estimates.
        left_out: Instances that were left out because fewer than 50 of their pixels have a depth.
        estimates: Their estimates.

    Returns:
        Axis to group to "instances", "left_out" for want of depth, the share with an estimate, and the shares under
        `metrics.THRESHOLDS`. Shares are over all instances of the group, without weights for the categories.
    """
    table: dict[str, Any] = {}
    for axis, group_of in AXES.items():
        groups = np.array([group_of(i) for i in asked])
        dropped = [group_of(i) for i in left_out]
        rows = {}
        for group in sorted({*groups.tolist(), *dropped}, key=_order(axis)):
            part = estimates.rows(groups == group)
            shares = metrics.shares(part.angle, part.position) if len(part) else dict.fromkeys(metrics.THRESHOLDS)
            estimated = float(part.made.mean()) if len(part) else None
            rows[group] = {
                "instances": len(part),
                "left_out": dropped.count(group),
                "estimated": estimated,
                **shares,
            }
        table[axis] = rows
    return table


def _bin(value: float, bins: tuple[tuple[float, str], ...]) -> str:
    return next(name for limit, name in bins if value < limit)


def _order(axis: str) -> Callable[[str], Any]:
    """Bins in their own order, names in the alphabet's."""
    bins = {"occlusion": _OCCLUSION, "distance": _DISTANCE, "f / width": _FOCAL}.get(axis, ())
    names = [name for _, name in bins]
    return lambda name: (names.index(name), "") if name in names else (len(names), name)
