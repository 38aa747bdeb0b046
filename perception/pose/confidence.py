"""How far to trust a pose: a small logistic model over what the network and the pooling say.

It predicts the probability that the pose is within 10 deg and 2 cm, and is fitted on held-out tools together with
clouds that are no EE of the claimed category (hands, other parts, other EEs), for which success is impossible.
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
"""[deg], [m] A pose within these, modulo its category's symmetry, is right: what confidence and trust are fitted to,
and what is reported of them."""
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


def features(
    category: Category,
    pooled: Pooled,
    sigmas: Array,
    points: int,
    valid_logit: float,
    regression_distance: float,
    regression_angle: float,
) -> Array:
    """The model's input (F,). sigmas: the network's (position [m], axis [rad], spin [rad]). regression_*: how far the
    pooled samples and the direct regression disagree [m], [rad]."""
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
    """p = sigmoid(bias + weights . (x - mean) / std); a pose is usable from `threshold` on. names: of the features."""

    mean: tuple[float, ...]
    std: tuple[float, ...]
    weights: tuple[float, ...]
    bias: float
    threshold: float = 0.5
    names: tuple[str, ...] = FEATURES

    def probability(self, x: Array) -> Array:
        """(...,) of features (..., F)."""
        z = (x - np.array(self.mean)) / np.array(self.std) @ np.array(self.weights) + self.bias
        return 1 / (1 + np.exp(-np.clip(z, -30, 30)))

    def to_dict(self) -> dict[str, Any]:
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
        """Raises ValueError when the model was fitted on other features."""
        if tuple(data["features"]) != names:
            raise ValueError("the confidence model was fitted on other features; train again")
        mean, std, weights = (tuple(map(float, data[k])) for k in ("mean", "std", "weights"))
        return ConfidenceModel(mean, std, weights, float(data["bias"]), float(data["threshold"]), names)


def fit(
    x: Array, success: Array, precision: float = 0.95, ridge: float = 10.0, names: tuple[str, ...] = FEATURES
) -> ConfidenceModel:
    """Fit on features (N, F) and success (N,) in {0, 1} by Newton's method on the ridge-penalised likelihood.

    ridge: with 1 instead of 10, the calibration error on other tools was twice as large. The threshold is the lowest
    one, 0.3 at least, above which the share of successes reaches `precision`.
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
    """Why a pose is refused, in words; "ok" if it is not."""
    if usable:
        return "ok"
    value = dict(zip(FEATURES, x, strict=True))
    if value["valid_logit"] < 0:
        return f"the cloud does not look like a {category}"
    if 10 ** value["log_points"] < 2 * MIN_POINTS:
        return f"only {round(10 ** value['log_points'])} points of the {category} are visible"
    if value["second_mode"] > 0.25:
        return f"two poses explain the {category} about equally well"
    sigma_mm, sigma_deg = 1e3 * np.exp(value["log_sigma_position"]), np.rad2deg(np.exp(value["log_sigma_axis"]))
    return f"the {category}'s pose is uncertain (about {sigma_mm:.0f} mm, {sigma_deg:.0f} deg)"
