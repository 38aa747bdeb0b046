"""What the clouds allow: each tool's exact shape, fitted to its cloud from the true pose.

No estimator that has to find pose and shape is asked for less. Where even this fit ends beside the truth, the depth
image does not hold the pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.frames import Array, inverse, transform, transform_points
from toolee_robot.perception.offline.dataset.catalogue import Catalogue
from toolee_robot.perception.offline.evaluation import metrics
from toolee_robot.perception.offline.evaluation.pose import GROUPS, by_category
from toolee_robot.perception.offline.evaluation.records import Case, Instance

SAMPLES = 20_000
"""Points on a tool's surface: some 2 mm apart on a hammer."""
ROUNDS, CHANGE = 30, 1e-6
"""Most rounds of a fit, and the step at which it ends [rad and m]."""
FAR = 0.015
"""Distance from the surface over which a point does not count [m]: it is another thing's."""
FEWEST = 20
"""Fewest points that count in a fit."""
ROBUST = 1.5
"""Residual over which a point counts less, in robust standard deviations (Huber)."""
_LEAST_NOISE = 3e-4  # [m]
_DAMPING = 1e-9  # share of the weights: a round head leaves the turn about its axis free


@dataclass(frozen=True, eq=False)
class Surface:
    """Points on a tool's surface, frame of its end effector.

    Attributes:
        points: (S, 3) [m].
        normals: (S, 3), unit, outward.
        tree: Of the points.
    """

    points: Array
    normals: Array
    tree: KDTree


@dataclass(frozen=True, eq=False)
class Fits:
    """One row per end effector, N in all; without a cloud the errors are infinite.

    Attributes:
        category: Index of its category, (N,).
        held_out: Whether training never showed the tool, (N,) bool.
        angle: Rotation error modulo the symmetry group, (N,) [rad].
        position: Position error, (N,) [m].
    """

    category: NDArray[np.int64]
    held_out: NDArray[np.bool_]
    angle: Array
    position: Array

    @classmethod
    def of(cls, instances: Sequence[Instance], errors: Sequence[tuple[float, float]]) -> Fits:
        """Join the fits of several end effectors.

        Args:
            instances: The end effectors.
            errors: Of each what `errors_of` gave [rad], [m].

        Returns:
            The fits.
        """
        angle, position = np.array(errors).reshape(-1, 2).T
        category = np.array([CATEGORIES.index(i.category) for i in instances], int)
        return cls(category, np.array([i.held_out for i in instances], bool), angle, position)

    def __len__(self) -> int:
        return len(self.category)

    def rows(self, chosen: NDArray[np.bool_]) -> Fits:
        """The rows of a mask (N,) bool."""
        return Fits(self.category[chosen], self.held_out[chosen], self.angle[chosen], self.position[chosen])


def fit_exact_shape(points: Array, surface: Surface, X_camera_ee: Array) -> Array:
    """Register points with a surface, point to plane (Chen and Medioni 1992), with Huber's weights.

    Args:
        points: Points of the tool, camera frame, (N, 3) [m].
        surface: The tool's surface.
        X_camera_ee: Where it begins, (4, 4).

    Returns:
        X_camera_ee, (4, 4); as it began where hardly a point is near the surface.
    """
    X_ee_camera = inverse(X_camera_ee)
    for _ in range(ROUNDS):
        at = transform_points(X_ee_camera, points)
        distance, nearest = surface.tree.query(at)
        normals = surface.normals[nearest]
        off = ((at - surface.points[nearest]) * normals).sum(1)
        near = distance <= FAR
        if near.sum() < FEWEST:
            break
        noise = max(1.4826 * float(np.median(np.abs(off[near]))), _LEAST_NOISE)
        weights = near / np.maximum(1.0, np.abs(off) / (ROBUST * noise))
        J = np.hstack([np.cross(at, normals), normals])
        normal_matrix = J.T @ (J * weights[:, None]) + _DAMPING * weights.sum() * np.eye(6)
        step = np.linalg.solve(normal_matrix, -J.T @ (weights * off))
        X_ee_camera = transform(Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]) @ X_ee_camera
        if float(np.linalg.norm(step)) < CHANGE:
            break
    return inverse(X_ee_camera)


def errors_of(instance: Instance, case: Case | None) -> tuple[float, float]:
    """Fit the exact shape to the cloud of an end effector and of the rest of its tool, from the true pose.

    Args:
        instance: The end effector.
        case: Its true mask with the cloud; None: it has none.

    Returns:
        Rotation error modulo the symmetry group [rad] and position error [m] of the fit; infinite without a cloud.
    """
    if case is None or not case.cloud.usable:
        return float("inf"), float("inf")
    surface = _surface(instance.catalogue, instance.tool, instance.ee)
    points = np.concatenate([case.cloud.points, case.cloud.rest])
    X, X_true = fit_exact_shape(points, surface, instance.X_camera_ee), instance.X_camera_ee
    angle = instance.category.symmetry.rotation_error(X[:3, :3], X_true[:3, :3])
    return float(angle), float(np.linalg.norm(X[:3, 3] - X_true[:3, 3]))


def tables(fits: Fits) -> dict[str, Any]:
    """Accuracy of the fits, for held-out and for seen instances, by category.

    Args:
        fits: The fits.

    Returns:
        For each group that occurs the shares under each of `metrics.THRESHOLDS`, and the medians of those with a
        cloud.
    """
    parts = zip(GROUPS, (fits.rows(fits.held_out), fits.rows(~fits.held_out)), strict=True)
    return {group: by_category(part, _row) for group, part in parts if len(part)}


def _row(fits: Fits) -> dict[str, Any]:
    made = np.isfinite(fits.position)
    return {
        **metrics.shares(fits.angle, fits.position),
        "median_mm": metrics.quantiles(1e3 * fits.position[made])["median"],
        "median_deg": metrics.quantiles(np.rad2deg(fits.angle[made]))["median"],
    }


@lru_cache(maxsize=64)
def _surface(catalogue: Catalogue, tool: int, ee: int) -> Surface:
    shape = catalogue.tool(tool)
    points, normals, _ = shape.sample_surface(SAMPLES, np.random.default_rng(0))
    X_ee_tool = inverse(shape.ees[ee].X_tool_ee)
    points = transform_points(X_ee_tool, points)
    return Surface(points, normals @ X_ee_tool[:3, :3].T, KDTree(points))
