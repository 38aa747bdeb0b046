"""Uniform cubic B-splines from rest to rest through a fixed configuration, and their sampling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.control.planning.timing import SAMPLE_PERIOD
from toolee_robot.frames import Array
from toolee_robot.station import ArmLimits


@dataclass(frozen=True)
class Spline:
    """Linear maps from one joint's m = intervals - 2 free coefficients to the motion of that joint.

    The motion is relative to its position at the contact, rests at both ends and passes the contact at a knot.

    Attributes:
        step: Time between two knots [s].
        intervals: Number of intervals.
        contact: Index of the knot at the contact.
        control: Map to the control points, (intervals + 3, m).
    """

    step: float
    intervals: int
    contact: int
    control: Array

    @classmethod
    def build(cls, step: float, before: int, after: int) -> Spline:
        """Build the maps.

        Args:
            step: Time between two knots [s].
            before: Number of intervals before the contact, at least 4.
            after: Number of intervals after it, at least 4.

        Returns:
            The spline.
        """
        n = before + after
        # Rest with zero acceleration at both ends: three equal control points.
        rest = np.zeros((n + 3, n - 1))
        rest[:3, 0] = rest[n:, -1] = 1.0
        rest[3:n, 1:-1] = np.eye(n - 3)
        # Zero at the contact: (c[k] + 4 c[k+1] + c[k+2]) / 6 = 0.
        mid = before - 1  # the free coefficient that is control point `before + 1`
        free = np.delete(np.eye(n - 1), mid, axis=1)
        free[mid] = -0.25 * (np.delete(np.eye(n - 1)[mid - 1] + np.eye(n - 1)[mid + 1], mid))
        return cls(step, n, before, rest @ free)

    @property
    def size(self) -> int:
        """Number of free coefficients of one joint."""
        return self.control.shape[1]

    @property
    def contact_time(self) -> float:
        """Time of the contact [s]."""
        return self.contact * self.step

    def at(self, times: Array, order: int = 0) -> Array:
        """Build the map from the free coefficients to the motion at given times.

        Args:
            times: Times within the motion, (N,) [s].
            order: 0 for positions, 1 for velocities, 2 for accelerations.

        Returns:
            The map, (N, m).
        """
        k = np.clip(np.floor(times / self.step + 1e-9).astype(int), 0, self.intervals - 1)
        u = times / self.step - k
        one = np.ones_like(u)
        if order == 0:
            w = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]) / 6
        elif order == 1:
            w = np.stack([-((1 - u) ** 2), 3 * u**2 - 4 * u, -3 * u**2 + 2 * u + one, u**2]) / (2 * self.step)
        else:
            w = np.stack([1 - u, 3 * u - 2, 1 - 3 * u, u]) / self.step**2
        basis = np.zeros((len(times), self.intervals + 3))
        rows = np.arange(len(times))
        for i in range(4):
            basis[rows, k + i] += w[i]
        return np.asarray(basis @ self.control)

    @property
    def knots(self) -> Array:
        """Times of the knots, (intervals + 1,) [s]."""
        return self.step * np.arange(self.intervals + 1, dtype=np.float64)

    def jerk(self) -> Array:
        """Map to the jerk in each interval, (intervals, m) [1/s^3]."""
        return np.diff(self.control, 3, axis=0) / self.step**3

    def velocity_hull(self) -> Array:
        """Map to the control points of the velocity, whose extremes bound it, (intervals + 2, m) [1/s]."""
        return np.diff(self.control, axis=0) / self.step


BEFORE, AFTER = 10, 8
"""Intervals of the spline before and after the contact."""


def spline_for(limits: ArmLimits) -> Spline:
    """Build a spline that is long enough for a swing.

    The intervals before the contact take a joint from rest to some 2 rad/s and from full acceleration to full
    deceleration, with 40 % to spare.

    Args:
        limits: Limits of acceleration and jerk.

    Returns:
        The spline; the time between two knots is a multiple of the sample period.
    """
    slowest = min(limits.acceleration)
    needed = 1.4 * (2.0 / slowest + 3.0 * slowest / limits.jerk)
    return Spline.build(SAMPLE_PERIOD * max(4, round(needed / BEFORE / SAMPLE_PERIOD)), BEFORE, AFTER)
