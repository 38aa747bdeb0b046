"""Metrics of poses and confidences. Errors are modulo the category's symmetry group alone, never a prediction."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array, angle_between, rotation_angle
from toolee_robot.perception.pose.confidence import RIGHT
from toolee_robot.symmetry import SymmetryGroup

THRESHOLDS: dict[str, tuple[float, float]] = {
    "5deg2cm": (5.0, 0.02),
    "5deg5cm": (5.0, 0.05),
    "10deg5cm": (10.0, 0.05),
    "10deg2cm": RIGHT,
    "5deg1cm": (5.0, 0.01),
    "5deg5mm": (5.0, 0.005),
    "2deg2mm": (2.0, 0.002),
}
"""Rotation [deg] and position [m]. The first three are the paper's."""


def within(angle: Array, position: Array, degrees: float, metres: float) -> NDArray[np.bool_]:
    """Which errors are under both thresholds.

    Args:
        angle: (N,) [rad]; infinite where there is no estimate.
        position: (N,) [m].
        degrees: Threshold of the angle [deg].
        metres: Threshold of the position [m].

    Returns:
        (N,) bool.
    """
    return np.asarray((angle < np.deg2rad(degrees)) & (position < metres))


def shares(angle: Array, position: Array) -> dict[str, float]:
    """Share of the errors that are below each of `THRESHOLDS`.

    Args:
        angle: Errors of the orientation, (N,) [rad].
        position: Errors of the position, (N,) [m].

    Returns:
        Name of the threshold -> share in [0, 1].
    """
    return {name: float(within(angle, position, *limits).mean()) for name, limits in THRESHOLDS.items()}


def paper_rule_angle(R: Array, R_true: Array, ambiguous: Array) -> float:
    """The paper's rotation error, which leaves out axes that the *prediction* calls ambiguous.

    Without such an axis: the whole angle. One: the angle between that axis in both poses. Two or three: 0.

    Args:
        R: Estimated rotation, 3x3.
        R_true: True rotation, 3x3.
        ambiguous: Predicted ambiguity, (3,); an axis is ambiguous over 0.5.

    Returns:
        The error [rad].
    """
    axes = np.flatnonzero(np.asarray(ambiguous) > 0.5)
    if len(axes) == 0:
        return rotation_angle(R.T @ R_true)
    if len(axes) == 1:
        return angle_between(R[:, axes[0]], R_true[:, axes[0]])
    return 0.0


def axis_angle(R: Array, R_true: Array, group: SymmetryGroup) -> float:
    """Angle between the z axes, modulo the symmetry group: a wrench turned over is the same wrench.

    Args:
        R: Estimated rotation, 3x3.
        R_true: True rotation, 3x3.
        group: Symmetry group.

    Returns:
        The angle [rad].
    """
    return angle_between(group.canonical(R, R_true)[:, 2], R_true[:, 2])


def calibration_error(confidence: Array, success: NDArray[np.bool_], bins: int = 10) -> float:
    """Expected calibration error: mean gap between confidence and success over equal bins, weighted by their size.

    Args:
        confidence: (N,) in [0, 1].
        success: (N,) bool.
        bins: Number of bins.

    Returns:
        The error; NaN without estimates.
    """
    if len(confidence) == 0:
        return float("nan")
    gaps = [abs(c - s) * n for c, s, n in reliability(confidence, success, bins)]
    return float(np.sum(gaps) / len(confidence))


def reliability(confidence: Array, success: NDArray[np.bool_], bins: int = 10) -> list[tuple[float, float, int]]:
    """Reliability over equal bins of the confidence.

    Args:
        confidence: (N,) in [0, 1].
        success: (N,) bool.
        bins: Number of bins.

    Returns:
        Mean confidence, share of successes and size of each bin that is not empty.
    """
    which = np.clip((confidence * bins).astype(int), 0, bins - 1)
    rows = [which == b for b in range(bins)]
    return [(float(confidence[r].mean()), float(success[r].mean()), int(r.sum())) for r in rows if r.any()]


def box_iou(X: Array, X_true: Array, low: Array, high: Array, group: SymmetryGroup, steps: int = 10) -> float:
    """Overlap of one box in two poses, on a grid. The rotation is first aligned modulo the group, as NOCS does.

    Args:
        X: Estimated pose, 4x4.
        X_true: True pose, 4x4.
        low: Lower corner of the box, (3,) [m].
        high: Upper corner, (3,) [m].
        group: Symmetry group.
        steps: Grid points per side.

    Returns:
        Intersection over union.
    """
    aligned = X.copy()
    aligned[:3, :3] = group.canonical(X[:3, :3], X_true[:3, :3])
    centres = (np.arange(steps) + 0.5) / steps
    grid = np.stack(np.meshgrid(centres, centres, centres, indexing="ij"), -1).reshape(-1, 3)
    points = (low + grid * (high - low)) @ aligned[:3, :3].T + aligned[:3, 3]
    local = (points - X_true[:3, 3]) @ X_true[:3, :3]
    inside = float(((local >= low) & (local <= high)).all(1).mean())
    return inside / (2 - inside)


def quantiles(values: Array) -> dict[str, Any]:
    """Median and 95th percentile; None for no values."""
    if len(values) == 0:
        return {"median": None, "p95": None}
    return {"median": float(np.median(values)), "p95": float(np.percentile(values, 95))}
