"""Fit where the head of a nail has moved since it was set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from toolee_robot.frames import Array
from toolee_robot.perception.nail.appearance import NailPose
from toolee_robot.perception.nail.change import Change

REACH, STEP = 0.009, 0.0015
"""How far from where it is expected a head is looked for, and in which steps [m]."""
STARTS, APART = 3, 0.0022
"""From how many places beside the expected one fits begin, and how far these are from each other at least [m]."""
SPREAD = 2.0
"""Errors as a multiple of what the noise of independent pixels would leave. By `benchmarks/bent_nails.py`."""
NEAR, PREFERRED = 0.0023, 4.0
"""A head that is found within this distance from where it is expected [m] is believed rather than one farther off that
explains the image better by less than so much, as a sum of squares in standard deviations."""
DIFFERENCE = 2.5e-4
"""Step of the derivatives [m]."""


@dataclass(frozen=True, eq=False)
class Moved:
    """A head that has moved.

    Attributes:
        offset: Displacement from where it is expected by the foot as it is seen now, x and y, (2,) [m].
        covariance: Its covariance, (2, 2) [m^2].
        misfit: Sum of squares that it leaves, in standard deviations.
    """

    offset: Array
    covariance: Array
    misfit: float


def fit_moved(change: Change, expected: NailPose, covariance: Array) -> Moved:
    """Fit foot and head to what has changed in an image.

    Args:
        change: The part of the image.
        expected: Where foot and head of a nail would be that was driven and not bent.
        covariance: How well that is known: covariance of foot and head, x and y, (4, 4) [m^2].

    Returns:
        The head.
    """
    fits = [_fit(change, expected, covariance, start) for start in _starts(change, expected)]
    best = min(fits, key=lambda fit: fit.misfit)
    near = [fit for fit in fits if np.hypot(*fit.offset) < NEAR and fit.misfit < best.misfit + PREFERRED]
    return min(near, key=lambda fit: fit.misfit) if near else best


def _at(expected: NailPose, x: Array) -> NailPose:
    """A nail whose foot and head are displaced by x, (4,) [m]."""
    return NailPose(expected.foot + np.array([*x[:2], 0.0]), expected.head + np.array([*x[2:], 0.0]))


def _starts(change: Change, expected: NailPose) -> list[Array]:
    """Displacements of the head at which fits begin, (2,) [m]: none, and those that explain the image best."""
    steps = np.arange(-REACH, REACH + 0.5 * STEP, STEP)
    places = [np.array([x, y]) for x in steps for y in steps if np.hypot(x, y) <= REACH]
    left = [np.sum(change.residuals(_at(expected, np.array([0.0, 0.0, *place]))) ** 2) for place in places]
    found: list[Array] = []
    for k in np.argsort(left):
        if len(found) < STARTS and all(np.hypot(*(places[k] - other)) > APART for other in found):
            found.append(places[k])
    return [np.zeros(2), *found]


def _fit(change: Change, expected: NailPose, covariance: Array, start: Array) -> Moved:
    known = np.linalg.cholesky(np.linalg.inv(covariance[:2, :2])).T

    def residuals(x: Array) -> Array:
        return np.concatenate([change.residuals(_at(expected, x)), SPREAD * known @ x[:2]])

    def slopes(x: Array) -> Array:
        steps = DIFFERENCE * np.eye(4)
        return np.stack([(residuals(x + s) - residuals(x - s)) / (2 * DIFFERENCE) for s in steps], axis=1)

    fit = least_squares(residuals, np.array([0.0, 0.0, *start]), jac=slopes, x_scale=1e-3, max_nfev=15)
    seen = SPREAD**2 * np.linalg.inv(fit.jac.T @ fit.jac + 1e2 * np.eye(4))
    # A foot that is elsewhere than believed tells of the head that is expected over it, and leaves open the rest.
    follows = covariance[2:, :2] @ np.linalg.inv(covariance[:2, :2])
    rest = covariance[2:, 2:] - follows @ covariance[:2, 2:]
    offset = np.hstack([-follows, np.eye(2)])
    return Moved(offset @ fit.x, offset @ seen @ offset.T + rest, 2.0 * float(fit.cost))
