"""Confidence of a pose: a logistic regression on what the network and the pooling report.

It predicts the probability that the pose is within 10 deg and 2 cm. It is fitted on held-out tools together with clouds
that are not an EE of the claimed category (hands, other parts, other EEs), for which success is impossible.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array
from toolee_robot.perception.pose.canonical import MIN_POINTS
from toolee_robot.perception.pose.pooling import Pooled

RIGHT = (10.0, 0.02)
"""A pose within this angle [deg] and distance [m], modulo the symmetry, is right: the criterion to which confidence and
trust are fitted and which is reported.
"""
FEATURES = (
    "log_sigma_position",
    "log_sigma_axis",
    "log_sigma_spin",
    "log_spread_position",
    "log_spread_angle",
    "main_mode",
    "second_mode",
    "log_points",
    "valid_logit",
    "regression_distance",
    "regression_angle",
    *(f"is_{category}" for category in Category),
)
"""Names of the model's inputs, in order."""


def features(
    category: Category,
    pooled: Pooled,
    sigmas: Array,
    points: int,
    valid_logit: float,
    regression_distance: float,
    regression_angle: float,
) -> Array:
    """Input of the confidence model.

    Args:
        category: Category of the EE.
        pooled: The pooled candidates.
        sigmas: The network's sigmas: position [m], axis [rad], spin [rad].
        points: Number of visible points.
        valid_logit: The network's logit that the cloud shows an EE of the category.
        regression_distance: Distance [m] between the pooled pose and the regressed one.
        regression_angle: Angle [rad] between them, modulo the symmetry.

    Returns:
        Feature vector (F,), in the order of `FEATURES`.
    """
    second = pooled.modes[1] if len(pooled.modes) > 1 else 0.0
    return np.array(
        [
            *np.log(np.maximum(sigmas, 1e-6)),
            np.log(pooled.spread_position + 1e-4),
            np.log(pooled.spread_angle + 1e-3),
            pooled.modes[0],
            second,
            np.log10(max(points, 1)),
            np.clip(valid_logit, -8, 8),
            np.log(regression_distance + 1e-4),
            np.log(regression_angle + 1e-3),
            *(float(category == other) for other in Category),
        ]
    )


@dataclass(frozen=True)
class ConfidenceModel:
    """Logistic regression p = sigmoid(bias + weights . (x - mean) / std).

    Attributes:
        mean: Mean of each feature, (F,).
        std: Standard deviation of each feature, (F,).
        weights: Weight of each standardised feature, (F,).
        bias: Bias of the logit.
        threshold: Least probability at which a pose is usable.
        names: Names of the features, (F,).
    """

    mean: tuple[float, ...]
    std: tuple[float, ...]
    weights: tuple[float, ...]
    bias: float
    threshold: float = 0.5
    names: tuple[str, ...] = FEATURES

    def probability(self, x: Array) -> Array:
        """Probabilities (...,) of features (..., F)."""
        z = (x - np.array(self.mean)) / np.array(self.std) @ np.array(self.weights) + self.bias
        return 1 / (1 + np.exp(-np.clip(z, -30, 30)))

    def to_dict(self) -> dict[str, Any]:
        """The model as a JSON object."""
        return {
            "features": list(self.names),
            "mean": list(self.mean),
            "std": list(self.std),
            "weights": list(self.weights),
            "bias": self.bias,
            "threshold": self.threshold,
        }

    @staticmethod
    def from_dict(data: dict[str, Any], names: tuple[str, ...] = FEATURES) -> ConfidenceModel:
        """Read a model.

        Args:
            data: JSON object of `to_dict`.
            names: Names of the features that the model must have.

        Returns:
            The model.

        Raises:
            ValueError: It was fitted on other features.
        """
        if tuple(data["features"]) != names:
            raise ValueError("the confidence model was fitted on other features; train again")
        mean, std, weights = (tuple(map(float, data[k])) for k in ("mean", "std", "weights"))
        return ConfidenceModel(mean, std, weights, float(data["bias"]), float(data["threshold"]), names)


def fit(
    x: Array, success: Array, precision: float = 0.95, ridge: float = 10.0, names: tuple[str, ...] = FEATURES
) -> ConfidenceModel:
    """Fit by Newton's method on the ridge-penalised likelihood.

    Args:
        x: Features (N, F).
        success: Whether each pose is right, (N,) in {0, 1}.
        precision: The threshold is the lowest, at least 0.3, above which this share of the poses is right.
        ridge: Penalty on the weights. 1 instead of 10 doubles the calibration error on other tools.
        names: Names of the features.

    Returns:
        The fitted model.
    """
    mean, std = x.mean(0), x.std(0) + 1e-3
    A = np.column_stack([(x - mean) / std, np.ones(len(x))])
    penalty = np.diag([ridge] * x.shape[1] + [1e-6])
    beta = np.zeros(A.shape[1])
    y = success.astype(np.float64)
    for _ in range(30):
        p = 1 / (1 + np.exp(-np.clip(A @ beta, -30, 30)))
        step = np.linalg.solve((A * (p * (1 - p))[:, None]).T @ A + penalty, A.T @ (y - p) - penalty @ beta)
        # Newton oversteps on separable data: bound the step.
        beta = beta + step * min(1.0, 5.0 / (np.linalg.norm(step) + 1e-12))
    model = ConfidenceModel(tuple(mean), tuple(std), tuple(beta[:-1]), float(beta[-1]))
    p = model.probability(x)
    order = np.argsort(-p)
    share = np.cumsum(y[order]) / np.arange(1, len(y) + 1)
    good = np.flatnonzero(share >= precision)
    threshold = max(float(p[order][good[-1]]), 0.3) if len(good) else 0.9
    return replace(model, threshold=min(threshold, 0.95), names=names)


def reason(category: Category, x: Array, usable: bool) -> str:
    """Why a pose is refused, for a person.

    Args:
        category: Category of the EE.
        x: Features of the pose, (F,).
        usable: Whether it is usable.

    Returns:
        The reason; "ok" if it is usable.
    """
    if usable:
        return "ok"
    value = dict(zip(FEATURES, x, strict=True))
    if value["valid_logit"] < 0:
        return f"the cloud does not look like a {category.label}"
    if 10 ** value["log_points"] < 2 * MIN_POINTS:
        return f"only {round(10 ** value['log_points'])} points of the {category.label} are visible"
    if value["second_mode"] > 0.25:
        return f"two poses explain the {category.label} about equally well"
    sigma_mm, sigma_deg = 1e3 * np.exp(value["log_sigma_position"]), np.rad2deg(np.exp(value["log_sigma_axis"]))
    return f"the {category.label}'s pose is uncertain (about {sigma_mm:.0f} mm, {sigma_deg:.0f} deg)"
