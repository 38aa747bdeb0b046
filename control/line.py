"""A straight line of the tool with a fixed orientation, in joint space: dense inverse kinematics and its derivatives.

Joint-space synchronisation does not keep a face straight; here every sample of a trajectory is solved for its own
pose, and velocity and acceleration follow from the path's first and second derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.control.inverse_kinematics import InverseKinematics
from toolee_robot.control.kinematics import solve
from toolee_robot.control.timing import PathProfile, ramp_length
from toolee_robot.errors import UnreachableError
from toolee_robot.frames import Array
from toolee_robot.types import Trajectory

_STEP = 1e-4  # [m], for the second derivative


@dataclass(frozen=True)
class PathLimits:
    """Limits on the path length: speed [m/s], acceleration [m/s^2], jerk [m/s^3], that keep every joint inside its
    own limits."""

    speed: float
    acceleration: float
    jerk: float


@dataclass(frozen=True)
class Line:
    """Flange poses X_base_flange(s) = X_contact shifted by s [m] along `direction` (3,) (unit, base axes).

    branch: of the inverse kinematics; q_zero (6,): the configuration at s = 0.
    """

    ik: InverseKinematics
    X_base_flange: Array
    direction: Array
    branch: int
    q_zero: Array

    @classmethod
    def through(cls, ik: InverseKinematics, q: Array, direction: Array) -> Line:
        """The line through the configuration q (6,), on its branch. Raises UnreachableError at a singularity."""
        return cls(ik, ik.arm.fk(q), direction / np.linalg.norm(direction), ik.branch_of(q), q)

    def q(self, s: Array) -> Array:
        """Configurations (M, 6) at s (M,) [m], ascending or descending. Raises UnreachableError where the line leaves the
        branch, passes a singularity or a joint's limit."""
        # The chain of whole turns starts at s = 0, where the configuration is known.
        order = np.argsort(s)
        s_sorted = np.concatenate([[0.0], s[order]])
        Xs = np.repeat(self.X_base_flange[None], len(s_sorted), axis=0)
        Xs[:, :3, 3] += s_sorted[:, None] * self.direction
        q = self.ik.branches_along(Xs[None], np.array([self.branch]), self.q_zero[None])[0]
        arm = self.ik.arm
        if not np.all(np.isfinite(q)):
            raise UnreachableError(
                f"the straight line is out of reach from s = {s_sorted[~np.isfinite(q[:, 0])][0]:.3f} m on"
            )
        if np.any((q < arm.lower) | (q > arm.upper)):
            raise UnreachableError("the straight line leaves a joint's position limits")
        out = np.empty((len(s), 6))
        out[order] = q[1:]
        return out

    def derivatives(self, q: Array) -> tuple[Array, Array]:
        """dq/ds [rad/m] and d2q/ds2 [rad/m^2], (M, 6) each, at q (M, 6)."""
        unit = np.concatenate([self.direction, np.zeros(3)])

        def slope(q: Array) -> Array:
            return solve(self.ik.arm.fk_jacobian(q)[1], np.broadcast_to(unit, (len(q), 6)))

        first = slope(q)
        second = (slope(q + _STEP * first) - slope(q - _STEP * first)) / (2 * _STEP)
        return first, second

    def timed(self, profile: PathProfile) -> Trajectory:
        """The line driven as the profile says."""
        q = self.q(profile.s)
        first, second = self.derivatives(q)
        qdd = first * profile.a[:, None] + second * (profile.v**2)[:, None]
        return Trajectory(profile.times, q, first * profile.v[:, None], qdd)

    def limits(self, q: Array, velocity: Array, acceleration: float, jerk: float, wanted: float) -> PathLimits:
        """The fastest motion through the configurations q (M, 6) up to `wanted` [m/s] whatever the run-up's length."""
        return path_limits(*self.derivatives(q), velocity, acceleration, jerk, wanted, np.inf)


def path_limits(
    first: Array, second: Array, velocity: Array, acceleration: float, jerk: float, wanted: float, run_up: float
) -> PathLimits:
    """Highest speed [m/s] up to `wanted` that a path with these derivatives (M, 6) can reach within `run_up` [m].

    Velocity: |q'| v <= velocity. Acceleration: |q'| a + |q''| v^2 <= acceleration. Jerk: |q'| j + 3 |q''| v a <= jerk
    (the third derivative is neglected, a tenth is held back for it). Speed 0 when there is none.
    """
    first, second = np.abs(first), np.abs(second)
    fastest = min(wanted, float(np.min(velocity / np.maximum(first, 1e-9))))
    speeds = fastest * np.linspace(1.0, 0.05, 40)
    left = acceleration * 0.98 - second * (speeds**2)[:, None, None]
    a = np.min(left / np.maximum(first, 1e-9), axis=(1, 2))
    a = np.where(a > 0.2, a, np.nan)
    left = jerk * 0.9 - 3 * second * (speeds * a)[:, None, None]
    j = np.min(left / np.maximum(first, 1e-9), axis=(1, 2))
    with np.errstate(invalid="ignore"):
        j = np.where(j > 2.0, j, np.nan)
        good = ramp_length(speeds, a, j) <= run_up
    if not np.any(good):
        return PathLimits(0.0, 0.2, 2.0)
    best = int(np.argmax(good))
    return PathLimits(float(speeds[best]), float(a[best]), float(j[best]))
