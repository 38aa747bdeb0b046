"""The swing as a sequence of quadratic programs.

    maximise    v - EFFORT (mean |jerk / jerk_max|^2 + 0.3 mean |qdd / qdd_max|^2)
    subject to  q(t_c) = q_c,  lateral velocity at t_c = 0,  axial velocity at t_c = v <= wanted
                |qd| <= qd_max, |qdd| <= qdd_max, |jerk| <= jerk_max, q_min <= q <= q_max
                |tau(q, qd, qdd)| <= share * tau_max                  inverse dynamics
                z(q) <= 0 before the contact, z(q) <= deepest after it, near the nail's axis around it
                speed of the fastest point of hand and tool <= the station's
                momentum of arm, hand and tool <= the station's

z is the distance of the face's centre beyond the contact along the nail's axis. Every joint's motion is a cubic
B-spline, in whose coefficients the first two lines are linear. The others are linearised about the previous solution,
the first time about rest at the contact. Source of the method: Betts, "Practical Methods for Optimal Control and
Estimation Using Nonlinear Programming", 2010 (direct transcription).
"""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np

from toolee_robot.control.arm_dynamics import ArmDynamics, torque_use
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.kinematics import ArmKinematics
from toolee_robot.control.limits import carried_speed
from toolee_robot.control.planning.swing_spline import Spline
from toolee_robot.control.planning.timing import SAMPLE_PERIOD
from toolee_robot.errors import LimitError
from toolee_robot.frames import Array
from toolee_robot.types import Trajectory

_TINY = 1e-6
"""Weight that makes a linear program strictly convex."""


@dataclass(frozen=True)
class Face:
    """The tool's face in the coordinates of the nail.

    Attributes:
        arm: Kinematics of the arm.
        X_flange_ee: Pose of the end effector in the flange, (4, 4).
        axes: Two directions across the nail's axis and the axis itself, which points into the wood; rows, (3, 3).
        nail: Centre of the nail's head in `base`, (3,) [m].
    """

    arm: ArmKinematics
    X_flange_ee: Array
    axes: Array
    nail: Array

    @classmethod
    def build(cls, arm: ArmKinematics, X_flange_ee: Array, X_base_nail: Array) -> Face:
        """Build from poses.

        Args:
            arm: Kinematics of the arm.
            X_flange_ee: Pose of the end effector in the flange, (4, 4).
            X_base_nail: Pose of the nail, (4, 4), z into the wood.

        Returns:
            The face.
        """
        return cls(arm, X_flange_ee, X_base_nail[:3, :3].T, X_base_nail[:3, 3])

    def place(self, q: Array) -> tuple[Array, Array]:
        """Compute where the face's centre is.

        Args:
            q: Joint positions, (N, 6) [rad].

        Returns:
            Position relative to the nail, (N, 3) [m], and the Jacobian, (N, 6, 6), whose rows are the face's linear
            [m/s] and angular velocity [rad/s]; all along `axes`.
        """
        X, J = self.arm.fk_jacobian(q)
        r = X[:, :3, :3] @ self.X_flange_ee[:3, 3]
        turn = J[:, 3:]
        linear = J[:, :3] + np.swapaxes(np.cross(np.swapaxes(turn, 1, 2), r[:, None]), 1, 2)
        return (X[:, :3, 3] + r - self.nail) @ self.axes.T, np.concatenate([self.axes @ linear, self.axes @ turn], 1)


def fastest(J: Array, velocity: Array) -> float:
    """Compute the speed along the axis that the joints' velocity limits allow with no speed across it.

    Args:
        J: Jacobian of the face along the nail's axes, (6, 6).
        velocity: Velocity limits, (6,) [rad/s].

    Returns:
        The speed [m/s].
    """
    bounds = np.concatenate([velocity, np.zeros(2)])
    sense = np.array([0] * 6 + [5] * 2, dtype=np.int32)
    qd, _, flag, _ = daqp.solve(_TINY * np.eye(6), -J[2], J[:2].copy(), bounds, -bounds, sense)
    return float(J[2] @ qd) if flag > 0 else 0.0


def decelerations(face: Face, dynamics: ArmDynamics, q: Array, acceleration: Array, torque: Array) -> Array:
    """Compute the largest deceleration of the face along the nail's axis from the contact on.

    A linear program for each configuration: the joints' accelerations within their limit, the torques of the inverse
    dynamics within theirs, at low speed.

    Args:
        face: The face.
        dynamics: Dynamics of arm, hand and tool.
        q: Configurations at the contact, (N, 6) [rad].
        acceleration: Acceleration limits, (6,) [rad/s^2].
        torque: Permitted torques, (6,) [Nm].

    Returns:
        The decelerations, (N,) [m/s^2]; 0 where the arm cannot even hold itself.
    """
    along = face.place(q)[1][:, 2]
    best = np.zeros(len(q))
    H = _TINY * np.eye(6)
    for i, row in enumerate(q):
        M, gravity = dynamics.at_rest(row)
        upper = np.concatenate([acceleration, torque - gravity])
        lower = np.concatenate([-acceleration, -torque - gravity])
        qdd, _, flag, _ = daqp.solve(H, along[i].copy(), M, upper, lower)
        if flag > 0:
            best[i] = -along[i] @ qdd
    return best


EFFORT = 0.03
"""Weight of the effort against the speed. Ten times less gives 8 % more speed at 20 mm, with twice the joint speeds and
a base that sweeps aside after the contact (one nail, UR10)."""
ITERATIONS = 6
"""Number of quadratic programs, at most; at least 3."""
HOLD = 3.0
"""Weight of the change of the joint positions from one program to the next [m/s/rad^2]."""
INSIDE = 0.98
"""Share of a linearised bound that the programs use; the rest is for the error of the linearisation."""
HEIGHT_ERROR = 0.003
"""Error of the nail's height within which the face is still square to 1 deg [m]."""
SQUARE = np.deg2rad(0.65)
"""Tilt of the face about each of two axes within the nail's height error [rad]; 0.92 deg in all."""
LATERAL, SLOPE = 0.002, 0.25
"""The face comes down within a cone about the nail's axis: LATERAL wide at the contact [m], wider by SLOPE."""
LATERAL_AFTER = 0.006
"""Lateral distance that is permitted while the face turns back [m]."""
BACK = 0.04
"""Least way of the face back from the deepest place that is permitted, at the end [m]: from 10 mm beyond the contact to
30 mm over it, and from a place that only bounds the stop not far."""
_FREE = 1e9


@dataclass(frozen=True)
class SwingProblem:
    """What a swing has to keep, at one configuration of the contact.

    Attributes:
        face: The face and the nail.
        dynamics: Dynamics of arm, hand and tool.
        spline: Parametrisation of the motion.
        q_contact: Joint positions at the contact, (6,) [rad].
        carried: Points of hand and tool in the frame of the last joint, (P, 3) [m].
        wanted: Wanted speed [m/s].
        velocity: Velocity limits, (6,) [rad/s].
        acceleration: Acceleration limits, (6,) [rad/s^2].
        jerk: Jerk limit of every joint [rad/s^3].
        torque: Permitted torques, (6,) [Nm].
        speed: Largest speed of any point of hand and tool [m/s].
        momentum: Largest momentum of arm, hand and tool [kg m/s].
        deepest: Largest distance of the face beyond the contact [m].
    """

    face: Face
    dynamics: ArmDynamics
    spline: Spline
    q_contact: Array
    carried: Array
    wanted: float
    velocity: Array
    acceleration: Array
    jerk: float
    torque: Array
    speed: float
    momentum: float
    deepest: float

    def solve(self) -> Array:
        """Solve the sequence of programs.

        Returns:
            Coefficients of the spline, (6, m), relative to `q_contact`.

        Raises:
            LimitError: There is no motion within the limits; code `limit.swing`.
        """
        H, f = self._cost()
        near = self.spline.at(self.spline.contact_time + self.spline.step * np.arange(-3.0, 4.0))
        hold = HOLD * _kron(np.eye(6), near.T @ near)
        fixed = self._joint_limits()
        x: Array = np.zeros(len(f))
        held: Array = np.zeros_like(H)
        for iteration in range(ITERATIONS):
            rows = _Rows([*fixed.parts])
            self._contact(rows)
            self._torques(rows, x)
            self._place(rows, x)
            if iteration:
                self._points(rows, x)
                self._carried_momentum(rows, x)
            A, lower, upper, sense = rows.stacked()
            x, _, flag, _ = daqp.solve(H + held, f - held @ x, A, upper, lower, sense, iter_limit=3000)
            if flag <= 0:
                raise LimitError(
                    "no swing through this contact keeps the limits of joints and torques: move the block, or use a "
                    "lighter hammer",
                    code="limit.swing",
                )
            held = hold
            if iteration >= 2 and self._depth(x) <= self.deepest:
                break
        return np.asarray(x.reshape(6, -1))

    def _depth(self, x: Array) -> float:
        """Deepest place of the face beyond the contact within the first intervals after it [m]."""
        M = self.spline.at(self.spline.contact_time + self.spline.step * np.linspace(0, 3, 19)[1:])
        return float(np.max(self.face.place(self.q_contact + self._joint_values(M, x))[0][:, 2]))

    def _cost(self) -> tuple[Array, Array]:
        spline, m = self.spline, self.spline.size
        jerk, push = spline.jerk() / self.jerk, spline.at(spline.knots, 2)
        jerks, pushes = jerk.T @ jerk / len(jerk), push.T @ push / len(push)
        effort = _kron(np.eye(6), EFFORT * jerks + 1e-7 * np.eye(m))
        effort += _kron(np.diag(0.3 * EFFORT / self.acceleration**2), pushes)
        return effort, -self._contact_velocity()[2]

    def _contact_velocity(self) -> Array:
        """Map of the coefficients to the face's velocity at the contact, (6, 6 m)."""
        J = self.face.place(self.q_contact[None])[1][0]
        return _kron(J, self.spline.at(np.array([self.spline.contact_time]), 1))

    def _joint_limits(self) -> _Rows:
        spline, arm, rows = self.spline, self.face.arm, _Rows([])
        rows.each_joint(spline.at(spline.knots[1:-1], 2), self.acceleration)
        rows.each_joint(spline.jerk(), np.full(6, self.jerk))
        rows.each_joint(spline.velocity_hull()[2:-2], self.velocity)
        # The ends are the extremes of a swing out and back; `check_trajectory` looks at the rest.
        ends = spline.control[[0, -1]]
        lower, upper = np.repeat(arm.lower - self.q_contact, 2), np.repeat(arm.upper - self.q_contact, 2)
        rows.add(_kron(np.eye(6), ends), lower, upper)
        return rows

    def _contact(self, rows: _Rows) -> None:
        C = self._contact_velocity()
        rows.add(C[:2], np.zeros(2), np.zeros(2), equality=True)
        rows.below(C[2:3], np.array([self.wanted]))
        # The face turns by less than SQUARE while it covers the height error.
        rate = SQUARE / HEIGHT_ERROR * C[2:3]
        for turn in (C[3:5], -C[3:5]):
            rows.below(turn - rate, np.zeros(2))

    def _torques(self, rows: _Rows, x: Array) -> None:
        times = self.spline.knots[1:]
        maps = [self.spline.at(times, order) for order in range(3)]
        state = [self._joint_values(m, x) for m in maps]
        tau, *slopes = self.dynamics.derivatives(self.q_contact + state[0], state[1], state[2])
        A = sum(s[:, :, :, None] * m[:, None, None, :] for s, m in zip(slopes, maps, strict=True))
        A = np.asarray(A).reshape(6 * len(times), -1)
        rest, bound = tau.ravel() - A @ x, np.tile(INSIDE * self.torque, len(times))
        rows.add(A / bound[:, None], -1 - rest / bound, 1 - rest / bound)

    def _place(self, rows: _Rows, x: Array) -> None:
        spline = self.spline
        steps = np.array([-5.0, -4, -3, -2.5, -2, -1.5, -1, -0.5, 0.25, 0.5, 0.75, 1, 1.25, 1.5, 2, 2.5, 3, 4, 5])
        steps = steps[(steps >= -spline.contact) & (steps <= spline.intervals - spline.contact)]
        times = np.append(spline.contact_time + steps * spline.step, spline.knots[-1])
        M = spline.at(times)
        p, J = self.face.place(self.q_contact + self._joint_values(M, x))
        A = J[:, :3, :, None] * M[:, None, None, :]
        A = A.reshape(len(times), 3, -1)
        rest = p - A @ x
        up, down = np.append(steps < 0, False), np.append(steps > 0, False)
        rows.below(A[up, 2], -rest[up, 2])
        for sign, axis in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
            rows.below(sign * A[up, axis] + SLOPE * A[up, 2], LATERAL - sign * rest[up, axis] - SLOPE * rest[up, 2])
        rows.below(A[down, 2], INSIDE * self.deepest - rest[down, 2])
        soon = np.append((steps > 0) & (steps <= 3), False)
        rows.add(A[soon, 0], -LATERAL_AFTER - rest[soon, 0], LATERAL_AFTER - rest[soon, 0])
        rows.add(A[soon, 1], -LATERAL_AFTER - rest[soon, 1], LATERAL_AFTER - rest[soon, 1])
        rows.below(A[-1:, 2], self.deepest - BACK - rest[-1:, 2])

    def _points(self, rows: _Rows, x: Array) -> None:
        times = self.spline.knots[1:-1]
        place, rate = self.spline.at(times), self.spline.at(times, 1)
        q, qd = self.q_contact + self._joint_values(place, x), self._joint_values(rate, x)
        R, p = self.face.arm.joints(q)
        X, J = self.face.arm.fk_jacobian(q)
        r = self.carried @ np.swapaxes(R[:, 5], 1, 2) + (p[:, 5] - X[:, :3, 3])[:, None]
        flange = (J @ qd[:, :, None])[:, :, 0]
        v = flange[:, None, :3] + np.cross(flange[:, None, 3:], r)
        size = np.linalg.norm(v, axis=-1)
        fastest = (np.arange(len(times)), np.argmax(size, axis=1))
        u, r = v[fastest] / np.maximum(size[fastest], 1e-9)[:, None], r[fastest]
        along = np.einsum("ni,nij->nj", u, J[:, :3]) + np.einsum("ni,nij->nj", np.cross(r, u), J[:, 3:])
        A = (along[:, :, None] * rate[:, None, :]).reshape(len(times), -1)
        rows.below(A, np.full(len(times), INSIDE * self.speed))

    def _carried_momentum(self, rows: _Rows, x: Array) -> None:
        times = self.spline.knots[1:-1]
        rate = self.spline.at(times, 1)
        q, qd = self.q_contact + self._joint_values(self.spline.at(times), x), self._joint_values(rate, x)
        maps = self.dynamics.momentum_maps(q)
        p = np.einsum("nij,nj->ni", maps, qd)
        along = p / np.maximum(np.linalg.norm(p, axis=1), 1e-9)[:, None]
        A = (np.einsum("ni,nij->nj", along, maps)[:, :, None] * rate[:, None, :]).reshape(len(times), -1)
        rows.below(A, np.full(len(times), INSIDE * self.momentum))

    def _joint_values(self, M: Array, x: Array) -> Array:
        """Apply a map of one joint's coefficients, (N, m), to all joints; (N, 6)."""
        return np.asarray(M @ x.reshape(6, -1).T)


def sampled_within(problem: SwingProblem, world: CollisionWorld, x: Array) -> tuple[Trajectory, int]:
    """Sample a solution, slowed down by what it exceeds the limits that were linearised.

    Slowing keeps the path, and so its deepest place.

    Args:
        problem: The problem.
        world: Bodies of hand and tool.
        x: Its solution: coefficients, (6, m), relative to the contact.

    Returns:
        The trajectory, and the index of the sample at the contact.

    Raises:
        LimitError: Gravity alone exceeds a torque; code `limit.torque`.
    """
    trajectory, contact = _sampled(problem.spline, problem.q_contact, x, 1.0)
    fastest = float(np.max(carried_speed(trajectory, world)))
    heaviest = float(np.max(problem.dynamics.momentum(trajectory.q, trajectory.qd)))
    torque = float(np.sqrt(np.max(torque_use(problem.dynamics, trajectory, problem.torque))))
    slower = max(torque, fastest / (0.998 * problem.speed), heaviest / problem.momentum)
    if slower <= 1.0:
        return trajectory, contact
    return _sampled(problem.spline, problem.q_contact, x, slower * (1 + 1e-4))


def _sampled(spline: Spline, q_contact: Array, x: Array, slower: float) -> tuple[Trajectory, int]:
    per_interval = int(np.ceil(spline.step * slower / SAMPLE_PERIOD - 1e-9))
    times = np.linspace(0.0, spline.knots[-1], spline.intervals * per_interval + 1)
    q, qd, qdd = (spline.at(times, order) @ x.T for order in range(3))
    return Trajectory(slower * times, q_contact + q, qd / slower, qdd / slower**2), spline.contact * per_interval


class _Rows:
    """Linear constraints lower <= A x <= upper, collected in parts."""

    def __init__(self, parts: list[tuple[Array, Array, Array, bool]]) -> None:
        self.parts = parts

    def add(self, A: Array, lower: Array, upper: Array, *, equality: bool = False) -> None:
        self.parts.append((A, lower, upper, equality))

    def below(self, A: Array, upper: Array) -> None:
        self.add(A, np.full(len(A), -_FREE), upper)

    def each_joint(self, M: Array, limit: Array) -> None:
        """Bound |M x_j| by the joint's limit, (6,)."""
        A = _kron(np.diag(1.0 / limit), M)
        self.add(A, -np.ones(len(A)), np.ones(len(A)))

    def stacked(self) -> tuple[Array, Array, Array, Array]:
        A, lower, upper = (np.concatenate([part[i] for part in self.parts]) for i in range(3))
        sense = np.concatenate([np.full(len(part[0]), 5 if part[3] else 0, dtype=np.int32) for part in self.parts])
        return A, lower, upper, sense


def _kron(a: Array, b: Array) -> Array:
    return np.asarray(np.kron(a, b), dtype=np.float64)
