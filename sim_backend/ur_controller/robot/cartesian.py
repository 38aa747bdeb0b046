"""Motions of the TCP in the controller's base frame: lines, arcs, speeds, stopping; force mode and freedrive.

In force mode the stand-in uses an admittance, since Universal Robots publishes no control law: along a compliant axis
the TCP moves at (desired + measured wrench) times a mobility, with a first-order lag.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import acos, pi, sqrt

import numpy as np

from toolee_robot import frames
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import StopDecelerations
from toolee_robot.sim_backend.ur_controller.robot import poses
from toolee_robot.sim_backend.ur_controller.robot.kinematics import chain, forward, inverse
from toolee_robot.sim_backend.ur_controller.robot.motion import Brake, Motion, MotionError, Move, Trapezoid, approach
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel

DAMPING = 1e-4  # of the inverse Jacobian: exact to 1e-6 except very close to a singularity
SINGULAR = 1.0 + 1e-3  # ratio of a joint velocity to its limit that ends a motion; allows for rounding


def joint_speeds(model: ControllerModel, q: Array, X_flange_tcp: Array, twist: Array) -> Array:
    """Joint velocities for a TCP velocity, by the damped inverse Jacobian.

    Args:
        model: The robot's model.
        q: Joint positions, (6,) [rad].
        X_flange_tcp: Pose of the TCP in the flange frame, 4x4.
        twist: Velocity of the TCP, (6,) [m/s, rad/s], base axes.

    Returns:
        Joint velocities, (6,) [rad/s].
    """
    links = chain(model, q)
    J = links.jacobian((links.X_base_flange @ X_flange_tcp)[:3, 3])
    return np.asarray(np.linalg.solve(J.T @ J + DAMPING**2 * np.eye(6), J.T @ twist), dtype=np.float64)


def tcp_twist(model: ControllerModel, q: Array, X_flange_tcp: Array, qd: Array) -> Array:
    """Velocity of the TCP.

    Args:
        model: The robot's model.
        q: Joint positions, (6,) [rad].
        X_flange_tcp: Pose of the TCP in the flange frame, 4x4.
        qd: Joint velocities, (6,) [rad/s].

    Returns:
        Velocity of the TCP, (6,) [m/s, rad/s], base axes.
    """
    links = chain(model, q)
    return links.jacobian((links.X_base_flange @ X_flange_tcp)[:3, 3]) @ qd


def _possible(model: ControllerModel, qd: Array) -> Array:
    over = np.abs(qd) / np.array(model.velocity)
    if over.max() > SINGULAR:
        joint = int(over.argmax())
        raise MotionError(f"joint {joint} would have to move at {abs(qd[joint]):.1f} rad/s: near a singularity?")
    return qd


class StopL(Brake):
    """`stopl`: as `Brake`, but with the deceleration of the TCP; no joint exceeds the model's acceleration.

    Args:
        model: The robot's model.
        X_flange_tcp: Pose of the TCP in the flange frame, 4x4.
        deceleration: Deceleration of the TCP [m/s^2], or [rad/s^2] if it only rotates.
    """

    def __init__(self, model: ControllerModel, X_flange_tcp: Array, deceleration: float) -> None:
        super().__init__(deceleration)
        self._model, self._X_flange_tcp = model, X_flange_tcp

    def speed(self, q: Array, qd: Array) -> float:
        twist = tcp_twist(self._model, q, self._X_flange_tcp, qd)
        speed = max(float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:])))
        return max(speed, super().speed(q, qd) * self._deceleration / self._model.acceleration)


class SpeedL(Motion):
    """`speedl`: accelerates the TCP to a velocity.

    Args:
        model: The robot's model.
        X_flange_tcp: Pose of the TCP in the flange frame, 4x4.
        twist_goal: Velocity of the TCP, (6,) [m/s, rad/s], base axes.
        acceleration: Linear acceleration [m/s^2].
        turning: Angular acceleration [rad/s^2].
    """

    def __init__(
        self, model: ControllerModel, X_flange_tcp: Array, twist_goal: Array, acceleration: float, turning: float
    ) -> None:
        super().__init__()
        self._model, self._X_flange_tcp, self._goal = model, X_flange_tcp, twist_goal
        self._acceleration, self._turning = acceleration, turning
        self._twist: Array | None = None

    def replan(self) -> None:
        """Accelerate from standstill."""
        self._twist = None

    def reached(self) -> bool:
        """Whether the velocity is reached."""
        return self._twist is not None and bool(np.all(self._twist == self._goal))

    def step(self, q: Array, qd: Array, scaled: float, dt: float) -> Array:
        if self._twist is None:
            full = qd * (dt / scaled) if scaled > 1e-3 * dt else np.zeros(6)
            self._twist = tcp_twist(self._model, q, self._X_flange_tcp, full)
        linear = _towards(self._twist[:3], self._goal[:3], self._acceleration * dt)
        angular = approach(self._twist[3:], self._goal[3:], self._turning * dt)
        self._twist = np.concatenate([linear, angular])
        qd_next = joint_speeds(self._model, q, self._X_flange_tcp, self._twist)
        return _possible(self._model, qd_next) * scaled


class ServoC(Motion):
    """`servoc`: moves the TCP straight to a pose, without a stop when the pose changes on the way.

    Args:
        model: The robot's model.
        X_flange_tcp: Pose of the TCP in the flange frame, 4x4.
        X_base_goal: Goal of the TCP, 4x4.
        acceleration: Acceleration [m/s^2, rad/s^2].
        speed: Speed [m/s, rad/s].
        blend: Distance from the goal at which the motion is finished [m].
    """

    def __init__(
        self,
        model: ControllerModel,
        X_flange_tcp: Array,
        X_base_goal: Array,
        acceleration: float,
        speed: float,
        blend: float,
    ) -> None:
        super().__init__()
        self._model, self._X_flange_tcp, self._goal = model, X_flange_tcp, X_base_goal
        self._acceleration, self._speed, self._blend = acceleration, speed, blend

    def step(self, q: Array, qd: Array, scaled: float, dt: float) -> Array:
        X = forward(self._model, q) @ self._X_flange_tcp
        way = poses.difference(X, self._goal)
        now = tcp_twist(self._model, q, self._X_flange_tcp, qd)
        change = self._acceleration * dt
        twist = np.empty(6)
        for part in (slice(0, 3), slice(3, 6)):
            distance = float(np.linalg.norm(way[part]))
            most = min(self._speed * scaled / dt, sqrt(2 * self._acceleration * distance + change**2 / 4) - change / 2)
            wanted = way[part] * min(1.0 / dt, most / distance) if distance > 1e-12 else np.zeros(3)
            twist[part] = _towards(now[part], wanted, change)
        near = float(np.linalg.norm(way[:3]))
        at_rest = max(near, float(np.linalg.norm(way[3:]))) < 1e-6
        self.done = near < self._blend or at_rest
        return _possible(self._model, joint_speeds(self._model, q, self._X_flange_tcp, twist)) * dt


def _towards(value: Array, goal: Array, most: float) -> Array:
    """`value` moved towards `goal` by at most the length `most`."""
    way = goal - value
    length = float(np.linalg.norm(way))
    return goal if length <= most else value + way * (most / length)


Path = tuple[Callable[[float], Array], float]
"""Pose X_base_tcp (4x4) as a function of the path length, and the total length: [m], or [rad] if the TCP rotates by
more [rad] than it translates [m]."""


def line(X_from: Array, X_to: Array) -> Path:
    """A straight path with a constant rotation axis.

    Args:
        X_from: Start, 4x4.
        X_to: End, 4x4.

    Returns:
        The path.
    """
    twist = poses.difference(X_from, X_to)
    length = max(float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:])))
    return (lambda s: poses.moved(X_from, twist * (s / length)) if length > 0.0 else X_to), length


def arc(X_from: Array, via: Array, X_to: Array, fixed: bool) -> Path:
    """A circular path through three points; collinear points give a straight path.

    Args:
        X_from: Start, 4x4.
        via: Point on the circle, (3,) [m].
        X_to: End, 4x4.
        fixed: Whether the orientation relative to the circle is kept; otherwise the rotation axis is constant.

    Returns:
        The path.

    Raises:
        MotionError: The end equals the start.
    """
    a, b, c = X_from[:3, 3], np.asarray(via), X_to[:3, 3]
    normal = np.cross(b - a, c - a)
    if np.linalg.norm(normal) < 1e-9:
        if np.linalg.norm(c - a) < 1e-9:
            raise MotionError("movec: the path ends where it starts")
        return line(X_from, X_to)
    square = float(normal @ normal)
    centre = a + np.cross(normal, b - a) * ((c - a) @ (c - a)) / (2 * square)
    centre += np.cross(c - a, normal) * ((b - a) @ (b - a)) / (2 * square)
    axis, first, last = normal / sqrt(square), a - centre, c - centre
    radius = float(np.linalg.norm(first))
    angle = acos(max(-1.0, min(1.0, float(first @ last) / radius**2)))
    if np.cross(first, last) @ axis < 0.0:
        angle = 2 * pi - angle
    turn = poses.difference(X_from, X_to)[3:]

    def at(s: float) -> Array:
        share = s / (radius * angle)
        R = poses.rotation(axis * (angle * share))
        X = X_from.copy()
        X[:3, 3] = centre + R @ first
        X[:3, :3] = (R if fixed else poses.rotation(turn * share)) @ X_from[:3, :3]
        return X

    return at, radius * angle


class PathMove(Move):
    """`movel`, `movep`, `movec`: moves the TCP on a path.

    Speed and acceleration are along the path: [m/s, m/s^2], or [rad/s, rad/s^2] for a path whose length is an angle.

    Args:
        model: The robot's model.
        X_flange_tcp: Pose of the TCP in the flange frame, 4x4.
        path: Returns the path for a start, 4x4.
        acceleration: Acceleration along the path.
        speed: Speed along the path.
        time: Duration [s] instead of speed and acceleration; 0 for none.
        blend: Distance from the end at which the next move may start [m].
    """

    def __init__(
        self,
        model: ControllerModel,
        X_flange_tcp: Array,
        path: Callable[[Array], Path],
        acceleration: float,
        speed: float,
        time: float,
        blend: float,
    ) -> None:
        super().__init__(model, X_flange_tcp, StopDecelerations().program, blend)
        self._X_tcp_flange, self._path = frames.inverse(X_flange_tcp), path
        self._acceleration, self._speed, self._duration = acceleration, speed, time
        self._pose: Callable[[float], Array] = lambda _s: X_flange_tcp

    @property
    def q_end(self) -> Array:
        """Joint positions at the end, (6,) [rad]."""
        return self._posture(self._profile.length, self._q)

    def _plan(self, q: Array) -> Trapezoid:
        self._pose, length = self._path(forward(self._model, q) @ self._X_flange_tcp)
        return Trapezoid(length, self._speed, self._acceleration, self._duration)

    def _posture(self, way: float, near: Array) -> Array:
        found = inverse(self._model, self._pose(way) @ self._X_tcp_flange, near)
        if found is None:
            raise MotionError("the path leaves the arm's reach")
        return np.array(found)

    def _at(self, way: float, near: Array, dt: float) -> Array:
        q = self._posture(way, near)
        _possible(self._model, (q - near) / dt)
        return q


MOBILITY = np.array([2e-3] * 3 + [5e-2] * 3)
"""Mobility, (6,) [m/s/N, rad/s/Nm], in force mode with a gain of 1."""
FREEDRIVE_GAIN = 5.0
TIME_CONSTANT = 0.05  # [s] of the lag


@dataclass
class Compliance:
    """Settings and state of force mode or freedrive.

    Attributes:
        R: Axes of the task frame in the base, (3, 3).
        axes: 1 for a compliant axis of the task frame, 0 for one that follows the command, (6,).
        wrench: Desired wrench of the arm on the environment, (6,) [N, Nm], task frame.
        speed: Largest speed along a compliant axis, (6,) [m/s, rad/s].
        gain: Factor of the mobility.
    """

    R: Array
    axes: Array
    wrench: Array
    speed: Array
    gain: float
    _twist: Array = field(default_factory=lambda: np.zeros(6))

    def apply(self, model: ControllerModel, X_flange_tcp: Array, q: Array, qd: Array, felt: Array, dt: float) -> Array:
        """Modify commanded joint velocities by the compliance.

        Args:
            model: The robot's model.
            X_flange_tcp: Pose of the TCP in the flange frame, 4x4.
            q: Set-point, (6,) [rad].
            qd: Commanded joint velocities, (6,) [rad/s].
            felt: Measured wrench at the TCP, (6,) [N, Nm], base axes.
            dt: Length of the tick [s].

        Returns:
            Joint velocities, (6,) [rad/s].
        """
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = self.R
        wanted = self.gain * MOBILITY * (self.wrench + turn.T @ felt)
        self._twist += (np.clip(wanted, -self.speed, self.speed) - self._twist) * min(dt / TIME_CONSTANT, 1.0)
        commanded = turn.T @ tcp_twist(model, q, X_flange_tcp, qd)
        twist = np.where(self.axes != 0, self._twist, commanded)
        limit = np.array(model.velocity)
        return np.clip(joint_speeds(model, q, X_flange_tcp, turn @ twist), -limit, limit)
