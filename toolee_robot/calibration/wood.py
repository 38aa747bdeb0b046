"""The plane of the wood: its height and how it rises, by touches with a known tip."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import chi2

from toolee_robot.errors import UserError
from toolee_robot.frames import Array, angle_between

MIN_TOUCHES = 3
"""Fewest touches; they determine the plane, and one more tells whether they lie on one."""
MIN_WIDTH = 0.030
"""Least width of the touched places across the line that they come nearest to [m]: touches that are 0.2 mm off, as
assumed, then tell the tilt across it to half a degree."""
AGREES = 0.999
"""Probability with which touches of a plane are as near to it as their stated deviation explains."""


@dataclass(frozen=True, eq=False)
class WoodPlane:
    """The plane of the wood's top.

    Attributes:
        point: A point of it, (3,) [m], `base`.
        rise: How it rises along x and y of `base`, (2,) [m per m].
        covariance: Covariance of the height at `point` and of the rise, (3, 3) [m, m per m].
        residuals: Heights of the touches over the plane, (N,) [m].
    """

    point: Array
    rise: Array
    covariance: Array
    residuals: Array

    @property
    def normal(self) -> Array:
        """Normal of the plane, out of the wood, `base`, (3,)."""
        v = np.array([-self.rise[0], -self.rise[1], 1.0])
        return np.asarray(v / np.linalg.norm(v))

    @property
    def tilt(self) -> float:
        """Angle of the normal to z of `base` [rad]."""
        return angle_between(self.normal, np.array([0.0, 0.0, 1.0]))

    @property
    def tilt_sigma(self) -> float:
        """Standard deviation of the rise about its least known direction [rad]."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[1:, 1:])[-1]))

    @property
    def residual(self) -> float:
        """Root mean square distance of the touches from the plane [m]; 0 where three determine it."""
        return float(np.sqrt(np.mean(self.residuals**2)))


def fit_wood(p: Array, at: Array, *, repeat: float, common: float) -> WoodPlane:
    """Fit the plane of the wood to touches, by least squares of their heights.

    Args:
        p: The tip at the touches, (N, 3) [m], `base`.
        at: Where the plane's height is wanted, x and y of `base`, (2,) [m].
        repeat: Standard deviation of a touch about each axis, by what differs from one touch to the next [m].
        common: Standard deviation of their height by what is the same in all: tip and kinematics [m].

    Returns:
        The plane.

    Raises:
        UserError: There are too few touches (`user.wood_few_touches`), they lie nearly on a line or too near to each
            other (`user.wood_degenerate`), or not on a plane (`user.wood_not_flat`).
    """
    if len(p) < MIN_TOUCHES:
        raise UserError(
            f"{len(p)} touches of the wood: give {MIN_TOUCHES} or more; a fourth reveals a wrong one",
            code="user.wood_few_touches",
        )
    _check_spread(p[:, :2])
    A = np.column_stack([np.ones(len(p)), p[:, :2] - at])
    (height, *rise), *_ = np.linalg.lstsq(A, p[:, 2], rcond=None)
    residuals = p[:, 2] - A @ np.array([height, *rise])
    slope = np.array(rise)
    # A touch that is off sideways is off the plane by as much times its rise.
    variance = repeat**2 * (1.0 + float(slope @ slope))
    information = A.T @ A
    _check_flat(A, residuals, np.sqrt(variance))
    covariance = variance * np.linalg.inv(information) + np.diag([common**2, 0.0, 0.0])
    return WoodPlane(np.array([*at, height]), slope, covariance, residuals)


def _check_spread(xy: Array) -> None:
    """Refuse places, (N, 2) [m], that are too near to a line."""
    widths = []
    for i, j in combinations(range(len(xy)), 2):
        along = xy[j] - xy[i]
        if (length := float(np.linalg.norm(along))) > 1e-9:
            widths.append(float(np.ptp((xy - xy[i]) @ np.array([-along[1], along[0]]) / length)))
    width = min(widths, default=0.0)
    if width >= MIN_WIDTH:
        return
    longest = max(float(np.linalg.norm(a - b)) for a, b in combinations(xy, 2))
    where = "nearly on a line" if width < 0.5 * longest else "too near to each other"
    raise UserError(
        f"the touches of the wood lie {where}: up to {longest * 1e3:.0f} mm apart, but only {width * 1e3:.0f} mm wide "
        f"across that. {MIN_WIDTH * 1e3:.0f} mm are needed. Touch once more, "
        f"{(MIN_WIDTH - width) * 1e3:.0f} mm further out across the line",
        code="user.wood_degenerate",
    )


def _check_flat(A: Array, residuals: Array, sigma: float) -> None:
    """Refuse touches whose distances from the plane their standard deviation [m] does not explain."""
    spare = len(A) - A.shape[1]
    if spare == 0 or residuals @ residuals <= sigma**2 * chi2.ppf(AGREES, spare):
        return
    # Distance of each touch from the plane of the others: the leverage tells it without another fit.
    leverage = np.einsum("ij,jk,ik->i", A, np.linalg.inv(A.T @ A), A)
    off = residuals / np.maximum(1.0 - leverage, 1e-9)
    more = f"more than touches of ±{sigma * 1e3:.1f} mm (--repeat-mm) explain"
    warped = "if it stays so the wood is warped: plane it, or take another block"
    if spare == 1:  # each of them as likely as the others
        least, most = np.min(np.abs(off)) * 1e3, np.max(np.abs(off)) * 1e3
        raise UserError(
            f"the four touches of the wood are not on a plane: each is {least:.1f} to {most:.1f} mm off that of the "
            f"others, {more}. One met something else. Touch once more to find it; {warped}",
            code="user.wood_not_flat",
        )
    # The most unlikely one, by how well the plane of the others is known at its place.
    worst = int(np.argmax(np.abs(residuals) / np.sqrt(np.maximum(1.0 - leverage, 1e-9))))
    side = "above" if off[worst] > 0 else "below"
    raise UserError(
        f"touch {worst + 1} of the wood is {abs(off[worst]) * 1e3:.1f} mm {side} the plane of the others, {more}: "
        f"touch there again; {warped}",
        code="user.wood_not_flat",
    )
