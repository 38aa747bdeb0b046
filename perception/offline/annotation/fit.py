"""Weighted least squares over clicks, robust to one wrong click, with the covariance of the pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from toolee_robot.errors import UserError
from toolee_robot.frames import Array

WRONG = 1e-4
"""Probability, were all clicks right, of an improvement as large as the one by leaving out the click called wrong."""
CLEARER = 8.0
"""By how much more than any other's the removal of the wrong click must improve chi-square."""
LARGEST_SCALE = 2.5
"""Residuals that are so many times larger than expected are no noise."""
_FREE_SPIN = np.pi**2 / 3


@dataclass(frozen=True, eq=False)
class Rows:
    """What the residuals of a model are.

    Attributes:
        owner: Index of the click that each residual belongs to, (R,); -1 for what is known beforehand.
        sigma: Their standard deviations, (R,).
        pixels: Which are in pixels, (R,); the others are in metres, or have no unit.
    """

    owner: NDArray[np.int64]
    sigma: Array
    pixels: NDArray[np.bool_]


class Model(Protocol):
    """What is fitted to the clicks.

    Attributes:
        rows: What its residuals are.
        free_spin: Whether nothing measures the turn about z.
    """

    rows: Rows
    free_spin: bool

    def start(self) -> Array:
        """Parameters to begin with, (P,), not thrown off by one wrong click."""

    def residuals(self, parameters: Array) -> Array:
        """Residuals (R,) in pixels and metres, as `rows` says."""

    def pose(self, parameters: Array) -> Array:
        """X_camera_ee, (4, 4)."""


@dataclass(frozen=True, eq=False)
class Fit:
    """The pose that fits the clicks.

    Attributes:
        X_camera_ee: The pose, 4x4.
        covariance: Its covariance, 6x6: position [m], rotation vector [rad], both in the camera's axes.
        parameters: The model's parameters, (P,).
        parameter_sigma: Their standard deviations, (P,).
        wrong: Index of the click that was left out because it contradicts the others; None: none.
        scale: How much larger than expected the residuals are; at least 1, and the covariance has grown by its square.
        redundancy: Number of measurements beyond those that determine the pose; 0: a wrong click does not show.
        pixels: Residual of each click in the image [px], by its index.
        metres: Residual of each click's depth [m], by its index.
    """

    X_camera_ee: Array
    covariance: Array
    parameters: Array
    parameter_sigma: Array
    wrong: int | None
    scale: float
    redundancy: int
    pixels: dict[int, float]
    metres: dict[int, float]


def fit(model: Model) -> Fit:
    """Fit a model to its clicks.

    Args:
        model: The model.

    Returns:
        The fit, without the one click that contradicts the others, if there is one.

    Raises:
        UserError: The clicks do not determine the pose, or contradict each other beyond one wrong click.
    """
    rows = model.rows
    everything = np.ones(len(rows.owner), dtype=bool)
    parameters, cost = _solve(model, everything)
    wrong = None
    if chi2.sf(cost, max(len(everything) - len(parameters), 1)) < 0.02:
        wrong, parameters, cost = _without_wrong(model, parameters, cost)
    kept = rows.owner != wrong if wrong is not None else everything
    redundancy = int(kept.sum()) - len(parameters)
    scale = float(np.sqrt(max(1.0, cost / redundancy))) if redundancy > 0 else 1.0
    if scale > LARGEST_SCALE:
        raise UserError(
            f"the clicks contradict each other: their residuals are {scale:.1f} times the expected error. Undo "
            "those with large residuals, and check in the cloud whether the depth there is the tool's",
            code="user.clicks_disagree",
        )
    X, covariance, sigma = _pose(model, parameters, kept, scale)
    raw = model.residuals(parameters)
    pixels: dict[int, float] = {}
    metres: dict[int, float] = {}
    for owner in np.unique(rows.owner[rows.owner >= 0]):
        of = rows.owner == owner
        if (of & rows.pixels).any():
            pixels[int(owner)] = float(np.linalg.norm(raw[of & rows.pixels]))
        if (of & ~rows.pixels).any():
            metres[int(owner)] = float(np.linalg.norm(raw[of & ~rows.pixels]))
    return Fit(X, covariance, parameters, sigma, wrong, scale, redundancy, pixels, metres)


def _solve(model: Model, kept: NDArray[np.bool_], start: Array | None = None) -> tuple[Array, float]:
    """Parameters with the least sum of squares over the kept rows, and that sum; from a robust fit, or a start."""
    begin = model.start() if start is None else start
    if kept.sum() < len(begin):
        raise UserError("the clicks do not determine the pose: make more of them", code="user.clicks_missing")

    def weighted(parameters: Array) -> Array:
        return (model.residuals(parameters) / model.rows.sigma)[kept]

    if start is None:
        begin = least_squares(weighted, begin, x_scale="jac", loss="soft_l1", max_nfev=60).x
    found = least_squares(weighted, begin, x_scale="jac", max_nfev=60)
    return found.x, float(2.0 * found.cost)


def _without_wrong(model: Model, parameters: Array, cost: float) -> tuple[int | None, Array, float]:
    """Leave out the one click whose removal explains the residuals, if one clearly does."""
    tried = []
    for owner in np.unique(model.rows.owner[model.rows.owner >= 0]):
        kept = model.rows.owner != owner
        redundancy = int(kept.sum()) - len(parameters)
        if redundancy < 1:
            continue
        # Without the wrong click, the start is good enough to need no robust loss first.
        without, rest = _solve(model, kept, model.start())
        gain = (cost - rest) / max(1.0, rest / redundancy)
        tried.append((gain, int(owner), int((~kept).sum()), without, rest))
    tried.sort(key=lambda t: t[0], reverse=True)
    if not tried:
        return None, parameters, cost
    gain, owner, removed, without, rest = tried[0]
    runner_up = tried[1][0] if len(tried) > 1 else 0.0
    if chi2.sf(gain, removed) * len(tried) > WRONG or gain < runner_up + CLEARER:
        return None, parameters, cost
    return owner, without, rest


def _jacobian(model: Model, parameters: Array) -> Array:
    """Derivatives of the weighted residuals, (R, P)."""
    return _derivatives(lambda p: model.residuals(p) / model.rows.sigma, parameters)


def _derivatives(function: object, parameters: Array) -> Array:
    assert callable(function)
    columns = []
    for k in range(len(parameters)):
        step = np.zeros(len(parameters))
        step[k] = 1e-6 * max(1.0, abs(parameters[k]))
        columns.append((function(parameters + step) - function(parameters - step)) / (2 * step[k]))
    return np.stack(columns, 1)


def _pose(model: Model, parameters: Array, kept: NDArray[np.bool_], scale: float) -> tuple[Array, Array, Array]:
    """The pose, its covariance, and the parameters' standard deviations."""
    J = _jacobian(model, parameters)[kept]
    X = model.pose(parameters)

    def moved(p: Array) -> Array:
        Y = model.pose(p)
        return np.concatenate([Y[:3, 3] - X[:3, 3], Rotation.from_matrix(Y[:3, :3] @ X[:3, :3].T).as_rotvec()])

    G = _derivatives(moved, parameters)
    size = np.linalg.norm(J, axis=0)
    information = (J / np.where(size > 0, size, 1.0)).T @ (J / np.where(size > 0, size, 1.0))
    if np.linalg.matrix_rank(information, tol=1e-9) < len(parameters):
        raise UserError(
            "the clicks do not determine the pose: spread them, not along one line", code="user.clicks_missing"
        )
    G = G / size
    covariance = scale**2 * G @ np.linalg.solve(information, G.T)
    if model.free_spin:
        z = X[:3, 2]
        covariance[3:, 3:] += _FREE_SPIN * np.outer(z, z)
    sigma = scale * np.sqrt(np.diag(np.linalg.inv(information))) / size
    return X, 0.5 * (covariance + covariance.T), sigma
