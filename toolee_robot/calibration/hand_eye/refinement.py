"""Joint refinement of camera and board by reprojection, with the robot's own errors in the weights.

A pose's corners share the error of the arm's pose, which is what matters: an image's noise is averaged over its corners
in any case. So the residuals of a view have the covariance S = sigma_px^2 I + G Sigma_arm G^T, with G the derivative by
the flange's pose, and a least-squares step is whitened with it. That is the bundle adjustment in which every flange
pose is a parameter with a prior, with these parameters eliminated. The three standard deviations (pixel, arm's
position, arm's rotation) are estimated from the residuals by restricted maximum likelihood (Patterson and Thompson,
1971) with a weak prior, and views that fit worse than 99.9 % of good ones get less weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, minimize
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from toolee_robot.calibration.hand_eye.reprojection import SCALE, Estimate, Projection, Views
from toolee_robot.frames import Array, skew

FITTING = float(chi2.ppf(0.999, 6))
"""Squared Mahalanobis distance of a view's flange pose up to which it has its full weight; beyond, the weight falls
faster than the distance grows, so that a wrong pose hardly counts."""
SQUARE_ERROR = 3e-4
"""Standard deviation of a board's square, relative: 0.1 mm of a rule on the bars of an A3."""
_PARAMETERS = 13
_START = (0.3, 5e-4, np.deg2rad(0.05))
"""First guess of the noise: pixel, position [m], rotation [rad]."""
_LEAST = (0.02, 2e-5, np.deg2rad(0.002))
"""Noise below which nobody's setup is."""
_USUAL = (3e-4, 1.5), (np.deg2rad(0.03), 1.0)
"""What is usual of an arm, position [m] and rotation [rad]: the median, and the standard deviation of the logarithm.
Few poses alone often tell a noise of zero, and a region that is too small with it."""
_ROUNDS = 12
_EVALUATIONS = 30
"""Evaluations of a solver that converges from a good start in ten; from a hopeless one it need not go on."""
_SETTLED = 1e-3
"""Change of the noise, relative, at which the rounds end."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the measurements, each about one axis.

    Attributes:
        pixel: Of a corner's place [px].
        position: Of the flange's position [m].
        rotation: Of the flange's rotation [rad].
    """

    pixel: float = _START[0]
    position: float = _START[1]
    rotation: float = _START[2]

    def near(self, other: Noise) -> bool:
        """Whether all three are as good as equal."""
        mine, theirs = (np.array([n.pixel, n.position, n.rotation]) for n in (self, other))
        return bool(np.max(np.abs(mine / theirs - 1.0)) < _SETTLED)


@dataclass(frozen=True, eq=False)
class Refined:
    """A refined calibration.

    Attributes:
        estimate: The calibration.
        covariance: Covariance of a step of `Estimate.moved`, (13, 13) [m, rad].
        noise: Estimated noise.
        weights: Weight of each view, (N,), 1 for one that fits.
        misfits: Squared Mahalanobis distance of each view's flange pose from what the others expect, over its 6 degrees
            of freedom: about 1 where the noise explains it, (N,).
        arm_errors: By how much the arm's pose of each view would be off if the others and the image were right:
            position [m] and rotation [rad], (N, 2).
        freedom: Degrees of freedom of the residuals of the poses.
    """

    estimate: Estimate
    covariance: Array
    noise: Noise
    weights: Array
    misfits: Array
    arm_errors: Array
    freedom: float

    def point_covariance(self, p_camera: Array) -> Array:
        """Covariance of a point that the camera sees, as expressed in `base`.

        Args:
            p_camera: The point in the camera's frame, (3,) [m].

        Returns:
            The covariance, (3, 3) [m^2], axes of `base`; of the calibration alone.
        """
        return point_covariance(self.covariance, self.estimate.X_base_camera, p_camera)

    def confidence_factor(self, share: float = 0.95, dimensions: int = 3) -> float:
        """Squared Mahalanobis radius of a confidence region, for a covariance that was estimated itself.

        Args:
            share: Probability of the region.
            dimensions: Dimensions of the error.

        Returns:
            The squared radius (Hotelling's T^2).
        """
        return confidence_factor(self.freedom, share, dimensions)


def point_covariance(covariance: Array, X_base_camera: Array, p_camera: Array) -> Array:
    """Covariance of a point that a calibrated camera sees, as expressed in `base`.

    Args:
        covariance: Covariance of the camera's position and rotation vector, axes of `base`, (6, 6) or larger.
        X_base_camera: Pose of the camera, (4, 4).
        p_camera: The point in the camera's frame, (3,) [m].

    Returns:
        The covariance, (3, 3) [m^2].
    """
    J = np.hstack([np.eye(3), -skew(X_base_camera[:3, :3] @ p_camera)])
    return np.asarray(J @ covariance[:6, :6] @ J.T)


def confidence_factor(freedom: float, share: float = 0.95, dimensions: int = 3) -> float:
    """Squared Mahalanobis radius of a confidence region under an estimated covariance (Hotelling's T^2).

    Args:
        freedom: Degrees of freedom of the covariance.
        share: Probability of the region.
        dimensions: Dimensions of the error.

    Returns:
        The squared radius.
    """
    left = max(freedom - dimensions + 1.0, 1.0)
    return float(dimensions * freedom / left * f_distribution.ppf(share, dimensions, left))


def refine(views: Views, start: Estimate, *, noise: Noise | None = None, square_error: float = SQUARE_ERROR) -> Refined:
    """Refine a calibration.

    Args:
        views: The observations.
        start: Where to begin: the result of a closed form.
        noise: The noise, if it is known, such as from a fit to more views; None: it is estimated.
        square_error: Standard deviation of the board's measured square, relative: how far its scale may follow the
            arm's motions. Infinite: the scale is as free as the poses.

    Returns:
        The refined calibration.
    """
    estimate, weights = start, np.ones(len(views.count))
    now = Noise() if noise is None else noise
    for _ in range(_ROUNDS):
        estimate = _solved(views, estimate, now, weights, square_error)
        reduced = _Reduced(views.project(estimate), views.count, square_error)
        before = now
        if noise is None:
            now = reduced.noise(weights, now)
        weights = reduced.weights(now, weights)
        if noise is not None:
            estimate = _solved(views, estimate, now, weights, square_error)
            break
        if now.near(before):
            break
    reduced = _Reduced(views.project(estimate), views.count, square_error)
    V = reduced.covariances(now)
    covariance = np.asarray(np.linalg.inv(reduced.information(V, weights)), np.float64)
    misfits = reduced.distances(V, covariance, weights) / 6.0
    freedom = 6.0 * float(np.sum(weights)) - 12.0
    return Refined(estimate, covariance, now, weights, misfits, reduced.arm_errors, max(freedom, 4.0))


def _solved(views: Views, estimate: Estimate, noise: Noise, weights: Array, square_error: float) -> Estimate:
    """Minimise the whitened reprojection error at a fixed noise and fixed weights."""
    prior = np.zeros((1, _PARAMETERS))
    prior[0, SCALE] = 1.0 / square_error
    for _ in range(3):
        whitening = _whitening(views.project(estimate), noise, weights)
        center = estimate

        def residuals(step: Array, center: Estimate = center, whitening: Array = whitening) -> Array:
            moved = center.moved(step)
            measured = np.einsum("nij,nj->ni", whitening, views.project(moved).residuals).ravel()
            return np.append(measured, (moved.scale - 1.0) / square_error)

        def jacobian(step: Array, center: Estimate = center, whitening: Array = whitening) -> Array:
            # By a step that follows `step`, which the solver takes for the derivative by `step`: exact at 0, where it
            # ends.
            J = views.project(center.moved(step)).by_parameters
            return np.vstack([(whitening @ J).reshape(-1, _PARAMETERS), prior])

        zero, unit = np.zeros(_PARAMETERS), np.full(_PARAMETERS, 1e-2)
        solution = least_squares(residuals, zero, jacobian, method="lm", x_scale=unit, max_nfev=_EVALUATIONS)
        estimate = center.moved(solution.x)
        if np.abs(solution.x).max() < 1e-6:
            break
    return estimate


def _whitening(projection: Projection, noise: Noise, weights: Array) -> Array:
    """Inverse square roots of the covariances of the views' residuals, (N, 2 M, 2 M)."""
    G = projection.by_flange * np.repeat([noise.position, noise.rotation], 3)
    S = noise.pixel**2 * np.eye(G.shape[1]) + G @ np.swapaxes(G, 1, 2)
    values, vectors = np.linalg.eigh(S)
    scale = np.sqrt(weights)[:, None] / np.sqrt(np.maximum(values, 1e-18))
    return np.asarray(scale[..., None] * np.swapaxes(vectors, 1, 2))


class _Reduced:
    """The linearised problem, with each view reduced to the flange pose that would explain it: 6 numbers a view.

    Args:
        projection: Residuals and derivatives.
        count: Corners of each view, (N,).
        square_error: As for `refine`.

    Attributes:
        arm_errors: As in `Refined`.
    """

    def __init__(self, projection: Projection, count: Array, square_error: float) -> None:
        G, r = projection.by_flange, projection.residuals
        normal = np.swapaxes(G, 1, 2) @ G
        self._A = np.linalg.inv(normal)
        to_pose = self._A @ np.swapaxes(G, 1, 2)
        self._z = np.einsum("nij,nj->ni", to_pose, r)
        self._H = to_pose @ projection.by_parameters
        self._prior = np.zeros((_PARAMETERS, _PARAMETERS))
        self._prior[SCALE, SCALE] = square_error**-2.0
        parts = (slice(3), slice(3, 6))
        self.arm_errors = np.stack([np.linalg.norm(self._z[:, part], axis=1) for part in parts], axis=1)
        # What no pose of the flange explains is noise of the image; a median over the views bears bad ones.
        rest = r - np.einsum("nij,nj->ni", G, self._z)
        self._pixel = float(np.sqrt(np.median(np.sum(rest**2, axis=1) / np.maximum(2 * count - 6, 1))))

    def covariances(self, noise: Noise) -> Array:
        """Covariances of the views' poses, (N, 6, 6)."""
        return np.asarray(
            noise.pixel**2 * self._A + np.diag(np.repeat([noise.position, noise.rotation], 3) ** 2), np.float64
        )

    def information(self, V: Array, weights: Array) -> Array:
        """Information of all views about the parameters, (P, P)."""
        weighted = weights[:, None, None] * np.swapaxes(self._H, 1, 2) @ np.linalg.inv(V)
        return np.asarray(np.einsum("npj,njq->pq", weighted, self._H) + self._prior)

    def distances(self, V: Array, covariance: Array, weights: Array) -> Array:
        """Squared Mahalanobis distances of the views' residuals, (N,), under what they have after the fit."""
        left = V - weights[:, None, None] * (self._H @ covariance @ np.swapaxes(self._H, 1, 2))
        # A view alone with its parameters has hardly any residual left: bound what it is divided by.
        left = 0.5 * (left + np.swapaxes(left, 1, 2)) + 1e-3 * V
        return np.asarray(np.einsum("ni,nij,nj->n", self._z, np.linalg.inv(left), self._z))

    def weights(self, noise: Noise, weights: Array) -> Array:
        """Weights of the views, at most 1."""
        V = self.covariances(noise)
        covariance = np.asarray(np.linalg.inv(self.information(V, weights)), np.float64)
        distances = self.distances(V, covariance, weights)
        return np.minimum(1.0, (FITTING / np.maximum(distances, FITTING)) ** 2)

    def noise(self, weights: Array, start: Noise) -> Noise:
        """Estimate the noise by restricted maximum likelihood."""
        pixel = max(self._pixel, _LEAST[0])

        def deviance(logs: Array) -> float:
            position, rotation = np.exp(logs)
            V = self.covariances(Noise(pixel, position, rotation)) / weights[:, None, None]
            inverse = np.linalg.inv(V)
            HtV = np.einsum("nip,nij->npj", self._H, inverse)
            information = np.einsum("npj,njq->pq", HtV, self._H) + self._prior
            score = np.einsum("npj,nj->p", HtV, self._z)
            square = np.einsum("ni,nij,nj->", self._z, inverse, self._z) - score @ np.linalg.solve(information, score)
            usual = sum(
                ((log - np.log(middle)) / width) ** 2 for log, (middle, width) in zip(logs, _USUAL, strict=True)
            )
            return float(np.linalg.slogdet(V)[1].sum() + np.linalg.slogdet(information)[1] + square + usual)

        bounds = [(np.log(_LEAST[1]), np.log(0.1)), (np.log(_LEAST[2]), np.log(0.5))]
        first = np.log([start.position, start.rotation])
        found = minimize(deviance, first, method="Nelder-Mead", bounds=bounds, options={"xatol": 1e-3, "fatol": 1e-4})
        position, rotation = np.exp(found.x)
        return Noise(pixel, float(position), float(rotation))
