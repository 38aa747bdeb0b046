"""Inverse kinematics of UR arms: all joint configurations that bring the flange to a pose.

The closed form of the nominal UR geometry gives up to eight branches (shoulder left or right, wrist flipped or not,
elbow up or down). Newton steps on the model's kinematics then remove the residual of the closed form (rounded angles
in the URDF; a factory calibration's millimetre). Source: Hawkins, "Analytic inverse kinematics for the Universal Robots
UR-5/UR-10 arms", Georgia Tech, 2013.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolee_robot.arm_data import ArmData
from toolee_robot.control.kinematics import ArmKinematics, solve
from toolee_robot.control.motion.trajectory_checks import START_TOLERANCE
from toolee_robot.errors import AssetError, UnreachableError
from toolee_robot.frames import Array, inverse
from toolee_robot.robots.urdf import DhParameters, dh_transform

BRANCHES = 8
"""Number of branches of the closed form."""
NEWTON_STEPS = 20
"""Largest number of Newton steps."""
NEWTON_ERROR = 1e-10
"""Largest residual of a solution [m, rad]. The closed form alone reaches it for nominal kinematics; a calibrated model
needs three or four steps, near a singularity up to a dozen."""
LARGEST_DEVIATION = 0.05
"""Bound of the deviation of an arm's kinematics from the closed form [m, rad]: Newton steps remove several times what a
factory's calibration deviates."""


class InverseKinematics:
    """Inverse kinematics of an arm with UR geometry: joints 2, 3 and 4 parallel, 5 and 6 orthogonal.

    Args:
        arm: Kinematics of the arm.

    Raises:
        AssetError: The kinematics are not those of a UR arm; code `asset.kinematics`.
    """

    def __init__(self, arm: ArmKinematics) -> None:
        self.arm = arm
        # In a UR's URDF at q = 0 the arm lies stretched out; the Denavit-Hartenberg lengths are sums along it.
        offset = arm.placements[:, :3, 3]
        self.d1 = offset[0, 2]
        self.d4 = offset[1, 1] + offset[2, 1] + offset[4, 1]
        self.a2, self.a3 = -offset[2, 2], -offset[3, 2]
        self.d5 = offset[5, 2]
        self.d6 = float(np.linalg.norm(arm.X_joint6_flange[:3, 3]))
        # The constant rotation between the bases of model and controller (half a turn in a UR's URDF).
        probe = np.array([0.3, -1.1, 0.9, -0.4, 0.7, 0.2])
        d, a = (self.d1, 0.0, 0.0, self.d4, self.d5, self.d6), (0.0, self.a2, self.a3, 0.0, 0.0, 0.0)
        dh = DhParameters(np.array(d), np.array(a), np.array(ArmData.alpha), np.zeros(6))
        turn = arm.fk(probe) @ inverse(dh.fk(probe))
        # A factory calibration deviates from the closed form by millimetres and milliradians, another arm by much more.
        off = float(np.abs(turn - arm.fk(-probe) @ inverse(dh.fk(-probe))).max())
        if not off < LARGEST_DEVIATION:
            raise AssetError(
                f"the kinematics are not those of a UR arm: they differ by {off:.2g} (m or rad), a factory "
                "calibration by about 0.01. Check arm.calibration and arm.model",
                code="asset.kinematics",
            )
        self._X_dh_base = inverse(turn)

    def branches(self, Xs_base_flange: Array) -> Array:
        """Compute all solutions.

        The branches are ordered shoulder (2) x wrist (2) x elbow (2), consistently along any path without a
        singularity.

        Args:
            Xs_base_flange: Poses of the flange, (..., 4, 4).

        Returns:
            Joint positions in (-pi, pi], (..., 8, 6) [rad]; NaN where a branch does not exist.
        """
        shape = Xs_base_flange.shape[:-2]
        X = np.broadcast_to(Xs_base_flange[..., None, :, :], (*shape, BRANCHES, 4, 4)).reshape(-1, 4, 4)
        q = self._closed_form(Xs_base_flange.reshape(-1, 4, 4)).reshape(-1, 6)
        ok = np.all(np.isfinite(q), axis=-1)
        q[ok] = self.polish(q[ok], X[ok])
        q[~ok] = np.nan
        return (np.mod(q + np.pi, 2 * np.pi) - np.pi).reshape(*shape, BRANCHES, 6)

    def solve(self, X_base_flange: Array, near: Array | None = None) -> list[Array]:
        """Compute the solutions for one pose that are within the position limits.

        Args:
            X_base_flange: Pose of the flange, (4, 4).
            near: Reference joint positions, (6,) [rad]; zero if None.

        Returns:
            The solutions, (6,) [rad] each, sorted by their distance from `near`.

        Raises:
            UnreachableError: There is none.
        """
        reference = np.zeros(6) if near is None else near
        q = self.branches(X_base_flange)
        q = self.unwrap(q[np.all(np.isfinite(q), axis=-1)], reference)
        q = q[np.all((q >= self.arm.lower) & (q <= self.arm.upper), axis=-1)]
        if len(q) == 0:
            p = X_base_flange[:3, 3]
            raise UnreachableError(
                f"no joint configuration brings the flange to {np.round(p, 3).tolist()} m with that orientation "
                f"({np.linalg.norm(p):.2f} m from the base): move the target or the base"
            )
        return sorted(q, key=lambda c: float(np.sum(np.abs(c - reference))))

    def branches_along(self, Xs_base_flange: Array, branch: NDArray[np.intp], near: Array) -> Array:
        """Compute one branch along each of C paths of M poses.

        Args:
            Xs_base_flange: Poses of the flange, (C, M, 4, 4).
            branch: Branch of each path, (C,).
            near: Joint positions, (C, 6) [rad]; the whole turns of a path's first configuration are chosen nearest to
                them.

        Returns:
            Joint positions, (C, M, 6) [rad], continuous along each path; NaN where the branch does not exist.
        """
        count, length = Xs_base_flange.shape[:2]
        X = Xs_base_flange.reshape(-1, 4, 4)
        q = self._closed_form(X)[np.arange(len(X)), np.repeat(branch, length)]
        ok = np.all(np.isfinite(q), axis=-1)
        q[ok] = self.polish(q[ok], X[ok])
        q = q.reshape(count, length, 6)
        whole = np.isfinite(q).all(axis=(1, 2))
        turned = np.unwrap(q[whole], axis=1)
        q[whole] = turned + 2 * np.pi * np.round((near[whole, None] - turned[:, :1]) / (2 * np.pi))
        return q

    def branch_of(self, q: Array) -> int:
        """Determine the branch of a configuration.

        Args:
            q: Joint positions, (6,) [rad].

        Raises:
            UnreachableError: The configuration is singular.
        """
        candidates = self.branches(self.arm.fk(q))
        error = np.abs(np.mod(candidates - q + np.pi, 2 * np.pi) - np.pi).max(axis=-1)
        error = np.where(np.isfinite(error), error, np.inf)
        best = int(np.argmin(error))
        if error[best] > START_TOLERANCE:  # an arm would refuse a line that starts there
            raise UnreachableError("the configuration is at a singularity: move the arm by some degrees first")
        return best

    def unwrap(self, q: Array, near: Array) -> Array:
        """Add whole turns so that every joint is as near to a reference as its limits allow.

        Args:
            q: Joint positions, (..., 6) [rad].
            near: Reference, broadcast to q [rad].

        Returns:
            Joint positions, (..., 6) [rad].
        """
        turn = 2 * np.pi
        q = near + np.mod(q - near + np.pi, turn) - np.pi
        q = np.where(q > self.arm.upper, q - turn, q)
        return np.where(q < self.arm.lower, q + turn, q)

    def polish(self, q: Array, Xs_base_flange: Array) -> Array:
        """Refine solutions with Newton steps.

        Args:
            q: Initial joint positions, (N, 6) [rad].
            Xs_base_flange: Poses of the flange, (N, 4, 4).

        Returns:
            Joint positions, (N, 6) [rad]; NaN where NEWTON_STEPS do not reach NEWTON_ERROR.
        """
        q, unmet = q.copy(), np.arange(len(q))
        for _ in range(NEWTON_STEPS):
            X, J = self.arm.fk_jacobian(q[unmet])
            wanted = Xs_base_flange[unmet]
            error = np.empty((len(unmet), 6))
            error[:, :3] = wanted[:, :3, 3] - X[:, :3, 3]
            # Half the sum of the axes' cross products: the rotation vector for small errors.
            error[:, 3:] = 0.5 * np.sum(np.cross(X[:, :3, :3], wanted[:, :3, :3], axis=1), axis=2)
            off = np.abs(error).max(axis=1) >= NEWTON_ERROR
            unmet = unmet[off]
            if len(unmet) == 0:
                break
            q[unmet] += np.clip(solve(J[off], error[off]), -0.2, 0.2)
        q[unmet] = np.nan
        return q

    def _closed_form(self, Xs_base_flange: Array) -> Array:
        """Closed-form solutions, (N, 8, 6) [rad], NaN where there is none."""
        X = self._X_dh_base @ Xs_base_flange
        n = len(X)
        R, p = X[:, :3, :3], X[:, :3, 3]
        q = np.empty((n, 2, 2, 2, 6))
        sign = np.array([1.0, -1.0])
        with np.errstate(invalid="ignore", divide="ignore"):
            p5 = p - self.d6 * R[:, :, 2]
            reach = np.hypot(p5[:, 0], p5[:, 1])
            q1 = (np.arctan2(p5[:, 1], p5[:, 0]) + np.pi / 2)[:, None] + sign * np.arccos(self.d4 / reach)[:, None]
            s1, c1 = np.sin(q1), np.cos(q1)
            c5 = (p[:, :1] * s1 - p[:, 1:2] * c1 - self.d4) / self.d6
            c5 = np.where(np.abs(c5) < 1 + 1e-9, np.clip(c5, -1, 1), np.nan)
            q5 = sign * np.arccos(c5)[:, :, None]  # (N, 2, 2)
            s5 = np.sin(q5)
            s1, c1, shape = s1[:, :, None], c1[:, :, None], (n, 1, 1)
            # At a wrist singularity the sixth joint is free; zero is chosen.
            sgn = np.where(np.abs(s5) < 1e-9, 0.0, np.sign(s5))
            y = (-R[:, 0, 1].reshape(shape) * s1 + R[:, 1, 1].reshape(shape) * c1) * sgn
            x = (R[:, 0, 0].reshape(shape) * s1 - R[:, 1, 0].reshape(shape) * c1) * sgn
            q6 = np.arctan2(y, x)
            X01 = dh_transform(q1[:, :, None] + 0 * q5, self.d1, 0.0, np.pi / 2)
            X46 = dh_transform(q5, self.d5, 0.0, -np.pi / 2) @ dh_transform(q6, self.d6, 0.0, 0.0)
            X14 = inverse(X01) @ X[:, None, None] @ inverse(X46)
            # Joints 2 and 3 as a planar two-link arm to the origin of frame 3.
            p3 = X14[..., :3, 3] - self.d4 * X14[..., :3, 1]
            squared = p3[..., 0] ** 2 + p3[..., 1] ** 2
            c3 = (squared - self.a2**2 - self.a3**2) / (2 * self.a2 * self.a3)
            q3 = sign * np.arccos(np.where(np.abs(c3) <= 1, c3, np.nan))[..., None]  # (N, 2, 2, 2)
            direction = np.arctan2(p3[..., 1], p3[..., 0])[..., None]
            q2 = direction - np.arctan2(self.a3 * np.sin(q3), self.a2 + self.a3 * np.cos(q3))
            # The pitch of frame 4 in frame 1 is the sum of the three parallel joints.
            q4 = np.arctan2(X14[..., 1, 0], X14[..., 0, 0])[..., None] - q2 - q3
        q[..., 0], q[..., 4], q[..., 5] = q1[:, :, None, None], q5[..., None], q6[..., None]
        q[..., 1], q[..., 2], q[..., 3] = q2, q3, q4
        return q.reshape(n, BRANCHES, 6)
