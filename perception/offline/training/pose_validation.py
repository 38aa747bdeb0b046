"""Evaluation and calibration on held-out clouds: metrics, covariance factors, confidence.

Errors are modulo the category's symmetry group alone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import Array, transform
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch
from toolee_robot.perception.pose import confidence
from toolee_robot.perception.pose.cloud_estimator import CloudEstimator, PoseResult
from toolee_robot.perception.pose.pooling import SigmaScale, align, pairwise_angles
from toolee_robot.perception.pose.weights import Calibration


class Evaluated:
    """Results beside the truth, N clouds.

    Args:
        batch: The clouds with their truth.
        results: The estimates.

    Attributes:
        results: The estimates.
        positive: Whether the cloud shows an EE of its category, (N,) bool.
        item: Row of the surface samples, (N,).
        Xs_true: True poses, (N, 4, 4), camera frame.
        position: Position errors, (N,) [m].
        angle: Rotation errors modulo the group, (N,) [rad].
        category: Index of the category, (N,).
        features: Input of the confidence model, (N, F).
    """

    def __init__(self, batch: CloudBatch, results: list[PoseResult]) -> None:
        self.results = results
        self.positive = batch.positive.cpu().numpy()
        self.item = batch.item.cpu().numpy()
        R_camera = batch.R_canonical.double().cpu().numpy().transpose(0, 2, 1)
        R = R_camera @ batch.R.double().cpu().numpy()
        p = np.einsum("bij,bj->bi", R_camera, batch.p.double().cpu().numpy()) + batch.centre.double().cpu().numpy()
        self.Xs_true = np.stack([transform(R_i, p_i) for R_i, p_i in zip(R, p, strict=True)])
        self.position = np.array(
            [np.linalg.norm(r.X_camera_ee[:3, 3] - X[:3, 3]) for r, X in zip(results, self.Xs_true, strict=True)]
        )
        self.angle = np.array(
            [
                pairwise_angles(np.stack([r.X_camera_ee[:3, :3], X[:3, :3]]), r.category.symmetry)[0, 1]
                for r, X in zip(results, self.Xs_true, strict=True)
            ]
        )
        self.category = np.array([CATEGORIES.index(r.category) for r in results])
        self.features = np.stack([r.features for r in results])

    def within(self, degrees: float, metres: float) -> Array:
        """Which estimates are accurate.

        Args:
            degrees: Bound of the orientation's error [deg].
            metres: Bound of the position's error [m].

        Returns:
            1 where both errors are below their bounds, else 0, (N,); 0 for negatives.
        """
        good = (self.angle < np.deg2rad(degrees)) & (self.position < metres) & self.positive
        return good.astype(np.float64)


def evaluate(estimator: CloudEstimator, batch: CloudBatch, candidates: int, seed: int = 0) -> Evaluated:
    """Estimate every cloud of a batch on the estimator's device, 256 at a time.

    Args:
        estimator: The estimator.
        batch: The clouds with their truth.
        candidates: Candidate poses per cloud.
        seed: Seed of the sampling.

    Returns:
        The results beside the truth.
    """
    generator = torch.Generator().manual_seed(seed)
    results: list[PoseResult] = []
    categories = CATEGORIES
    with torch.inference_mode():
        for start in range(0, len(batch), 256):
            part = batch.select(torch.arange(start, min(start + 256, len(batch)), device=batch.points.device))
            named = [categories[int(i)] for i in part.category]
            visible = part.visible.cpu().numpy()
            results += estimator.infer(part.cloud, named, part.direction, visible, generator, candidates)
    return Evaluated(batch, results)


def without_direction(batch: CloudBatch) -> CloudBatch:
    """The batch with the direction to the rest of the tool unknown."""
    return replace(batch, direction=torch.zeros_like(batch.direction))


def without_rest(batch: CloudBatch) -> CloudBatch:
    """The batch with the rest of the tool unseen."""
    return replace(batch, rest=torch.zeros_like(batch.rest), rest_known=torch.zeros_like(batch.rest_known))


def metrics(evaluated: Evaluated, rows: Array | None = None) -> dict[str, Any]:
    """Shares and medians of the positives per category.

    Args:
        evaluated: The results.
        rows: Which of them to use, (N,) bool; None: all.

    Returns:
        A row per category, and as "average" the mean over the categories.
    """
    chosen = evaluated.positive if rows is None else evaluated.positive & rows
    table: dict[str, Any] = {}
    for i, category in enumerate(Category):
        of = chosen & (evaluated.category == i)
        if not of.any():
            continue
        table[category.value] = {
            "clouds": int(of.sum()),
            "5deg_2cm": float(evaluated.within(5, 0.02)[of].mean()),
            "5deg_1cm": float(evaluated.within(5, 0.01)[of].mean()),
            "10deg_2cm": float(evaluated.within(*confidence.RIGHT)[of].mean()),
            "median_mm": float(1e3 * np.median(evaluated.position[of])),
            "median_deg": float(np.rad2deg(np.median(evaluated.angle[of]))),
        }
    keys = ("5deg_2cm", "5deg_1cm", "10deg_2cm", "median_mm", "median_deg")
    rows_ = list(table.values())
    table["average"] = {k: float(np.mean([row[k] for row in rows_])) for k in keys} if rows_ else {}
    return {k: {n: round(v, 4) for n, v in row.items()} for k, row in table.items()}


def calibrate(evaluated: Evaluated) -> Calibration:
    """Fit covariance factors and confidence model to results of an estimator whose factors were 1."""
    scales = {}
    good = evaluated.within(20, 0.04) > 0
    for i, category in enumerate(Category):
        of = np.flatnonzero(good & (evaluated.category == i))
        scales[category] = _scale(evaluated, of, category) if len(of) >= 30 else SigmaScale()
    return Calibration(scales, confidence.fit(evaluated.features, evaluated.within(*confidence.RIGHT)))


def confidence_report(evaluated: Evaluated, calibration: Calibration) -> dict[str, float]:
    """Evaluate the confidence model.

    Args:
        evaluated: The results.
        calibration: The calibration to evaluate.

    Returns:
        Expected calibration error, threshold, coverage and precision of the usable poses, share of negatives that pass.
    """
    p = calibration.confidence.probability(evaluated.features)
    success = evaluated.within(*confidence.RIGHT)
    usable = p >= calibration.confidence.threshold
    bins = np.clip((p * 10).astype(int), 0, 9)
    gap = [
        abs(p[bins == b].mean() - success[bins == b].mean()) * (bins == b).mean()
        for b in range(10)
        if (bins == b).any()
    ]
    positive = evaluated.positive
    return {
        "expected_calibration_error": round(float(np.sum(gap)), 4),
        "threshold": round(calibration.confidence.threshold, 4),
        "coverage_of_positives": round(float(usable[positive].mean()), 4) if positive.any() else 0.0,
        "precision_10deg_2cm": round(float(success[usable].mean()), 4) if usable.any() else 0.0,
        "precision_5deg_1cm": round(float(evaluated.within(5, 0.01)[usable].mean()), 4) if usable.any() else 0.0,
        "negatives_passed": round(float(usable[~positive].mean()), 4) if (~positive).any() else 0.0,
    }


def _scale(evaluated: Evaluated, rows: NDArray[np.intp], category: Category) -> SigmaScale:
    """Factors that make the mean normalised squared error 1, without the worst 2.5 % (left to the confidence)."""
    group = category.symmetry
    position, angle = [], []
    for i in rows:
        result, X = evaluated.results[i], evaluated.Xs_true[i]
        dp = result.X_camera_ee[:3, 3] - X[:3, 3]
        R = align(X[None, :3, :3], result.X_camera_ee[:3, :3], group)[0]
        w = Rotation.from_matrix(R @ result.X_camera_ee[:3, :3].T).as_rotvec()
        position.append(dp @ np.linalg.solve(result.covariance[:3, :3] + 1e-10 * np.eye(3), dp) / 3)
        # Aligned modulo a continuous group, two of the three rotations are left.
        freedom = 2 if group.kind == "Cinf" else 3
        angle.append(w @ np.linalg.solve(result.covariance[3:, 3:] + 1e-8 * np.eye(3), w) / freedom)

    def factor(values: list[float]) -> float:
        ordered = np.sort(values)[: max(int(0.975 * len(values)), 1)]
        return float(np.clip(np.sqrt(ordered.mean()), 0.2, 5.0))

    return SigmaScale(factor(position), factor(angle))
