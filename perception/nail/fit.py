"""Fit where a nail that is seen for the first time stands to a part of an image, by least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from toolee_robot.frames import Array
from toolee_robot.perception.nail.appearance import Appearance, Comparison, NailPose, Window

SPREAD = 3.0
"""Errors as a multiple of what independent pixels would leave: wood has a grain. By `benchmarks/bent_nails.py`."""
FAINT = 0.03
"""Least that is left of a mixture of channels, as a share of what is left of a channel."""
LEAN = np.deg2rad(3.0)
"""Standard deviation of the lean, to each side, of a nail that a person has set upright: assumed. The lean that the
first image tells along the line of sight is 4 degrees off as a rule, and more now and then."""
OVERRULED = 3.0
"""The usual lean is overruled where its best fit leaves so many standard deviations more than the best fit of any lean.
Of 120 simulated nails with the usual lean the worst leaves 2.5; of 120 that lean by 12 to 25 degrees 107 leave 3 or
more."""
ACROSS = np.hstack([-np.eye(2), np.eye(2)])
"""From foot and head, x and y, to the head's displacement from the foot, (2, 4)."""
DIFFERENCE = 2.5e-4
"""Step of the derivatives [m]: a tenth of a pixel or more."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A pose of a nail that was fitted to a part of an image.

    Attributes:
        pose: The pose.
        covariance: Covariance of foot and head, x and y, (4, 4) [m^2].
        comparison: How the image compares with it.
        misfit: Sum of squares that it leaves, that of an unusual lean included, in units of the image, squared.
    """

    pose: NailPose
    covariance: Array
    comparison: Comparison
    misfit: float


@dataclass(frozen=True, eq=False)
class View:
    """A part of an image to which poses of a nail are fitted.

    Attributes:
        look: What a nail looks like.
        window: The part.
        image: The part of the image, (h, w, n), in channels of brightness or mixtures of them.
        wood: Which of its pixels count, (h, w); None for all.
        slope: How the nail is believed to lean, x and y of `base` per z, from which a lean is weighed.
    """

    look: Appearance
    window: Window
    image: NDArray[np.float64]
    wood: NDArray[np.bool_] | None = None
    slope: tuple[float, float] = (0.0, 0.0)

    def compare(self, pose: NailPose) -> Comparison:
        """How the part compares with a nail."""
        return self.look.compare(self.image, self.window, pose, self.wood)

    def fit(self, start: NailPose, noise: float | None = None) -> Fit:
        """Fit the places of foot and head.

        Args:
            start: Where the fit begins; its heights stay.
            noise: Noise of a pixel, `SPREAD` included, in units of the image, against which a lean is weighed that
                nails do not have as a rule; None where every lean is as good.

        Returns:
            The fit.
        """
        height = (start.head - start.foot)[2]
        usual, believed = LEAN * height, height * np.asarray(self.slope)

        def pose(x: Array) -> NailPose:
            return NailPose(start.foot + np.array([*x[:2], 0.0]), start.head + np.array([*x[2:], 0.0]))

        def residuals(x: Array) -> Array:
            at = pose(x)
            seen = self.compare(at).residuals
            return (
                seen if noise is None else np.concatenate([seen, noise / usual * ((at.head - at.foot)[:2] - believed)])
            )

        def slopes(x: Array) -> Array:
            steps = DIFFERENCE * np.eye(4)
            return np.stack([(residuals(x + s) - residuals(x - s)) / (2 * DIFFERENCE) for s in steps], axis=1)

        fit = least_squares(residuals, np.zeros(4), jac=slopes, x_scale=1e-3, max_nfev=20)
        left = 2.0 * fit.cost / max(len(fit.fun) - 4, 1)
        information = fit.jac.T @ fit.jac + 1e-6 * left * np.eye(4) / DIFFERENCE**2
        variance = SPREAD**2 * left if noise is None else noise**2
        covariance = variance * np.linalg.inv(information)
        return Fit(pose(fit.x), covariance, self.compare(pose(fit.x)), 2.0 * float(fit.cost))


def whitening(left: Array) -> Array:
    """Mixtures of channels that have nothing in common and the variance one.

    Args:
        left: What is left of channels in some pixels, (m, n).

    Returns:
        The mixtures, (n, n): `left` times them is white.
    """
    n = left.shape[1]
    covariance = left.T @ left / max(len(left), 1)
    return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance + FAINT**2 * np.trace(covariance) / n * np.eye(n))))


def fit_as_set(view: View, start: NailPose, anyhow: Fit) -> Fit:
    """Fit a nail that a person has set: upright but for the usual lean, unless the image surely tells another.

    A nail is a line of a few pixels, and its head one of two: what a longer or a shorter one would show, along the line
    of sight, differs by little, and by less than the grain of some wood.

    Args:
        view: The image.
        start: An upright nail near to where it stands.
        anyhow: The fit from there for which every lean is as good.

    Returns:
        The fit. Its covariance is of this optimum alone, and knows nothing of others that leave little more.
    """
    noise = SPREAD * float(np.sqrt(anyhow.comparison.left))
    usual = min((view.fit(one, noise) for one in _upright(start, anyhow.pose)), key=lambda fit: fit.misfit)
    return usual if usual.misfit < anyhow.misfit + (OVERRULED * noise) ** 2 else anyhow


def _upright(start: NailPose, leaning: NailPose) -> Sequence[NailPose]:
    """Where fits of an upright nail begin: at the start, and with the foot and with the head of a nail that leans."""
    up = start.head - start.foot
    return [start, NailPose(leaning.foot, leaning.foot + up), NailPose(leaning.head - up, leaning.head)]
