"""What has changed in an image since a nail was set, how well a moved nail explains it, and where its head is now.

Where the first image shows the wood, the later one differs from it by a nail, by noise and by light: a gain and a plane
of brightness, and shadows, which darken wood and leave its hue. Where the first image shows the nail, the wood behind
it follows from that beside it, but for its grain, whose hue is the wood's, too. Steel is grey: a nail that bends turns
to other lamps, and becomes brighter or darker without another hue. So it is the hue that tells a nail from wood.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from toolee_robot.frames import Array
from toolee_robot.perception.nail.appearance import Appearance, NailPose, Window

GREY, HUE = 40.0, 7.0
"""How much a nail's parts turn brighter or darker as it bends, and how much their colours change otherwise: standard
deviations [brightness]. In simulated labs 40, and 1 to 8 otherwise."""
SHADE = 0.02
"""Standard deviation of a shadow, as a share of the wood's brightness: assumed."""
QUIET = 1.0
"""Least noise of a pixel [brightness]."""
BARE, HIDDEN = 0.02, 0.3
"""A pixel shows the wood where the nail covers less than the first share of it, and the nail hides the wood's grain
from the second share on."""
FILLED = 0.1
"""Share of a pixel from which on the wood behind the nail is taken from beside it. Below, the nail's part of it is
subtracted."""


@dataclass(frozen=True, eq=False)
class AsSet:
    """A nail as it was set, as the first look saw it.

    Attributes:
        look: What the nail looks like.
        pose: Where it stood.
        covariance: Covariance of its foot and head, x and y, (4, 4) [m^2].
        colours: How much brighter than what is around them shank and head were, (2, 3).
        image: The image, (H, W, 3).
        wood: Which pixels show the wood or what stands on it, (H, W).
    """

    look: Appearance
    pose: NailPose
    covariance: Array
    colours: Array
    image: NDArray[np.float64]
    wood: NDArray[np.bool_]


class Change:
    """A part of a later image of a nail, against that of the nail as it was set.

    Args:
        before: The nail as it was set.
        image: The later image, (H, W, 3).
        window: The part.
        counted: Which of the later image's pixels count, (H, W); they are to be most of the part, or not far from it.
    """

    def __init__(self, before: AsSet, image: NDArray[np.float64], window: Window, counted: NDArray[np.bool_]) -> None:
        self._look, self._window, self._colours = before.look, window, before.colours.ravel()
        counted = window.cut(counted) & window.cut(before.wood)
        self._counted = counted.ravel()
        first = window.cut(before.image)
        covered = before.look.covered(window, before.pose)
        share = covered.sum(axis=1)
        radius = max(1.0, before.look.scale(before.pose.head) * before.look.head_radius)
        around, grain = _wood_around(first, share.reshape(window.shape), counted, radius)
        subtracted = first - (covered @ before.colours).reshape(first.shape)
        wood = np.where(share[:, None] > FILLED, around.reshape(-1, 3), subtracted.reshape(-1, 3))
        bare = (share < BARE) & self._counted
        added = window.cut(image).reshape(-1, 3) - wood
        plane = window.plane
        left = added - plane @ np.linalg.lstsq(plane[bare], added[bare], rcond=None)[0]
        noise = max(QUIET, float(1.48 * np.median(np.abs(left[bare]))))  # of a few of its pixels that is the nail
        hidden = np.clip(share / HIDDEN, 0.0, 1.0)[:, None, None]
        shade = SHADE**2 * wood[:, :, None] * wood[:, None, :]
        covariance = noise**2 * np.eye(3) + hidden * grain + shade
        whiten = np.linalg.cholesky(np.linalg.inv(covariance)).transpose(0, 2, 1)
        self._whiten = whiten[self._counted]
        light = np.einsum("pij,pk->pikj", self._whiten, plane[self._counted]).reshape(-1, 9)
        gain = np.einsum("pij,pj->pij", self._whiten, (wood - wood.mean(axis=0))[self._counted]).reshape(-1, 3)
        self._light = np.linalg.qr(np.hstack([light, gain]))[0]
        self._added = self._unlit(np.einsum("pij,pj->pi", self._whiten, added[self._counted]).ravel())
        usual = np.linalg.inv(GREY**2 * np.ones((3, 3)) / 3.0 + HUE**2 * np.eye(3))
        self._usual = np.kron(np.eye(2), np.linalg.cholesky(usual).T)

    def residuals(self, pose: NailPose) -> Array:
        """What a nail leaves unexplained, by its best colours, in standard deviations.

        Args:
            pose: Where it stands.

        Returns:
            The differences of the pixels, and those of its colours from what they were, (n,).
        """
        covered = self._look.covered(self._window, pose)[self._counted]
        nail = self._unlit(np.einsum("pij,pk->pikj", self._whiten, covered).reshape(-1, 6))
        added = self._added - nail @ self._colours
        changed = np.linalg.solve(nail.T @ nail + self._usual.T @ self._usual, nail.T @ added)
        return np.concatenate([added - nail @ changed, self._usual @ changed])

    def _unlit(self, whitened: Array) -> Array:
        """Whitened differences of the pixels but for what a change of the light explains."""
        return np.asarray(whitened - self._light @ (self._light.T @ whitened))


def _wood_around(
    image: NDArray[np.float64], share: Array, counted: NDArray[np.bool_], radius: float
) -> tuple[NDArray[np.float64], Array]:
    """What the wood around it tells of pixels.

    Args:
        image: The part of an image, (h, w, 3).
        share: Which share of the pixels a nail covers, (h, w).
        counted: Which of the pixels count, (h, w).
        radius: From how far around a pixel the wood is taken [pixel].

    Returns:
        The wood, (h, w, 3), and how far off it is where the wood next to a pixel is not seen, covariance (3, 3).
    """
    bare = np.clip(1.0 - 4.0 * share, 0.0, 1.0) * counted
    gaussian = np.asarray(cv2.getGaussianKernel(2 * int(np.ceil(3.0 * radius)) + 1, radius)[:, 0], float)
    kernel = np.outer(gaussian, gaussian)
    wood = _mean_around(image, bare, kernel)
    middle = len(kernel) // 2
    beside = slice(middle - round(radius), middle + round(radius) + 1)
    kernel[beside, beside] = 0.0  # as much as a nail hides
    seen = (share < BARE) & counted
    off = image[seen] - _mean_around(image, bare, kernel)[seen]
    return wood, np.asarray(off.T @ off / max(len(off), 1))


def _mean_around(image: NDArray[np.float64], weight: Array, kernel: Array) -> NDArray[np.float64]:
    total = np.maximum(cv2.filter2D(weight, -1, kernel), 1e-6)
    return np.asarray(cv2.filter2D(image * weight[..., None], -1, kernel) / total[..., None])


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
