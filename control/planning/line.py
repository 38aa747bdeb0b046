"""A straight line of the tool with a fixed orientation, in joint space: dense inverse kinematics and its derivatives.

Joint-space synchronisation does not keep a face straight; here every sample of a trajectory is solved for its own
pose, and velocity and acceleration follow from the path's first and second derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.control.inverse_kinematics import InverseKinematics
from toolee_robot.control.kinematics import ArmKinematics, solve
from toolee_robot.control.planning.timing import PathProfile
from toolee_robot.errors import UnreachableError
from toolee_robot.frames import Array
from toolee_robot.types import Trajectory

_STEP = 1e-4  # [m], for the second derivative


@dataclass(frozen=True)
class PathLimits:
    """Limits on the path length that keep every joint inside its own: speed [m/s], acceleration and braking [m/s^2],
    jerk [m/s^3]."""

    speed: float
    acceleration: float
    brake: float
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
        """Configurations (M, 6) at s (M,) [m] in any order. Raises UnreachableError where the line leaves the
        branch, passes a singularity or a joint's limit."""
        # The chain of whole turns starts at s = 0, where the configuration is known.
        order = np.argsort(s)
        s_sorted = np.concatenate([[0.0], s[order]])
        Xs = np.repeat(self.X_base_flange[None], len(s_sorted), axis=0)
        Xs[:, :3, 3] += s_sorted[:, None] * self.direction
        q = self.ik.branches_along(Xs[None], np.array([self.branch]), self.q_zero[None])[0]
        arm = self.ik.arm
        reached = np.isfinite(q).all(axis=1)
        if not reached.all():
            raise UnreachableError(f"the straight line is out of reach from s = {s_sorted[~reached][0]:.3f} m on")
        if np.any((q < arm.lower) | (q > arm.upper)):
            raise UnreachableError("the straight line leaves a joint's position limits")
        out = np.empty((len(s), 6))
        out[order] = q[1:]
        return out

    def derivatives(self, q: Array) -> tuple[Array, Array]:
        """dq/ds [rad/m] and d2q/ds2 [rad/m^2], (M, 6) each, at q (M, 6)."""
        return line_derivatives(self.ik.arm, q, self.direction)

    def timed(self, profile: PathProfile) -> Trajectory:
        """The line driven as the profile says."""
        q = self.q(profile.s)
        first, second = self.derivatives(q)
        qdd = first * profile.a[:, None] + second * (profile.v**2)[:, None]
        return Trajectory(profile.times, q, first * profile.v[:, None], qdd)

    def travel_limits(self, q: Array, velocity: Array, acceleration: float, jerk: float, wanted: float) -> PathLimits:
        """Limits for a slow motion through the configurations q (M, 6): up to `wanted` [m/s]."""
        first, second = (np.maximum(np.abs(d), 1e-9) for d in self.derivatives(q))
        speed = min(wanted, float(np.min(velocity / first)), float(np.sqrt(np.min(0.5 * acceleration / second))))
        top = float(np.min(0.5 * acceleration / first))
        return PathLimits(speed, top, top, 0.5 * jerk / float(np.max(first)))


def line_derivatives(arm: ArmKinematics, q: Array, direction: Array) -> tuple[Array, Array]:
    """dq/ds [rad/m] and d2q/ds2 [rad/m^2], (M, 6) each, of straight motion along `direction` (3,) at q (M, 6)."""
    unit = np.concatenate([direction, np.zeros(3)])

    def slope(q: Array) -> Array:
        return solve(arm.fk_jacobian(q)[1], np.broadcast_to(unit, (len(q), 6)))

    first = slope(q)
    second = (slope(q + _STEP * first) - slope(q - _STEP * first)) / (2 * _STEP)
    return first, second


def strike_limits(
    s: Array, first: Array, second: Array, velocity: Array, acceleration: float, jerk: float, wanted: float
) -> PathLimits:
    """The highest speed at s = 0, up to `wanted` [m/s], that the joints allow for a strike along s (M,) [m].

    first, second (M, 6): the line's derivatives at s, which runs from the start of the run-up (negative) to the deepest
    point of braking. The ramp fills the whole run-up, so v^2 grows about linearly along it; it falls linearly while
    braking. Joint acceleration is q' a + q'' v^2 with the signs it has; the jerk keeps 40 % back for the terms in q''
    and q'''. Speed 0 when there is none.
    """
    run_up, deepest = -float(s[0]), float(s[-1])
    up = s <= 0
    acceleration = 0.97 * acceleration
    slope = np.maximum(np.abs(first), 1e-9)
    j = 0.6 * jerk / float(np.max(slope))
    fastest = min(wanted, float(np.min(velocity / slope)))
    v = fastest * np.linspace(1.0, 0.1, 46)
    # The acceleration whose ramp is as long as the run-up: v / a + a / j = 2 L / v.
    duration = 2 * run_up / v
    inside = (j * duration) ** 2 - 4 * j * v
    a = 1.01 * 0.5 * (j * duration - np.sqrt(np.maximum(inside, 0.0)))
    share = np.where(up, (s + run_up) / run_up, 1 - s / max(deepest, 1e-9))
    centripetal = second * (v**2)[:, None, None] * np.clip(1.05 * share, 0, 1)[:, None]
    driven = first * a[:, None, None]
    worst = np.maximum(np.abs(driven + centripetal), np.maximum(np.abs(driven), np.abs(centripetal)))
    possible = (inside > 0) & np.all(worst[:, up] <= acceleration, axis=(1, 2))
    # Braking: q'' v^2 adds to -q' a where they have opposite signs.
    against = np.where(first * centripetal < 0, np.abs(centripetal), 0.0)
    brake = np.min((acceleration - against[:, ~up]) / slope[~up], axis=(1, 2))
    possible &= brake > 0.5
    if not np.any(possible):
        return PathLimits(0.0, 0.5, 0.5, j)
    best = int(np.argmax(possible))
    return PathLimits(float(v[best]), float(a[best]), float(brake[best]), j)
