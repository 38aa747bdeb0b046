"""Motions in joint space, and the base classes of all motions. A motion computes the joints' displacement in each tick.

Displacements add up: a blended move ends while the next one already starts. Accelerations are the requested ones,
limited by the model's; no motion has a jerk limit.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import sqrt

import numpy as np

from toolee_robot.errors import TooleeError
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot.kinematics import forward
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel

STANDSTILL = 1e-9  # [rad/s] joint speed below which a joint counts as standing


class MotionError(TooleeError):
    """The arm cannot execute a motion."""


class Motion(ABC):
    """A motion of the arm.

    Attributes:
        done: Whether the motion is finished.
        stays: Whether it continues when the script function that started it has ended.
    """

    stays = False

    def __init__(self) -> None:
        self.done = False

    def replan(self) -> None:  # noqa: B027  (most motions compute each tick from where the arm is)
        """Take into account that the arm has left the motion's path and stands."""

    def follow(self, before: Motion) -> None:  # noqa: B027  (most motions take nothing over)
        """Take over from the motion that this one replaces."""

    @abstractmethod
    def step(self, q: Array, qd: Array, scaled: float, dt: float) -> Array:
        """Compute the displacement of one tick.

        Args:
            q: Set-point, (6,) [rad].
            qd: Velocity of the set-point, (6,) [rad/s].
            scaled: Length of the tick, scaled by slider and pause [s].
            dt: Length of the tick [s].

        Returns:
            Displacement of the joints, (6,) [rad].

        Raises:
            MotionError: The arm cannot follow.
        """


class Brake(Motion):
    """Brings the arm to rest along its current direction in joint space, independent of slider and pause.

    Args:
        deceleration: Deceleration of the fastest joint [rad/s^2].
    """

    stays = True

    def __init__(self, deceleration: float) -> None:
        super().__init__()
        self._deceleration = deceleration

    def speed(self, q: Array, qd: Array) -> float:  # noqa: ARG002  (`StopL` uses q)
        """The speed that the deceleration reduces: here that of the fastest joint.

        Args:
            q: Joint positions, (6,) [rad].
            qd: Joint velocities, (6,) [rad/s].

        Returns:
            The speed [rad/s].
        """
        return float(np.abs(qd).max())

    def step(self, q: Array, qd: Array, scaled: float, dt: float) -> Array:  # noqa: ARG002
        speed = self.speed(q, qd)
        left = max(speed - self._deceleration * dt, 0.0)
        self.done = left <= STANDSTILL
        return np.zeros(6) if self.done else qd * (left / speed * dt)


class SpeedJ(Motion):
    """`speedj`: accelerates the joints to velocities.

    Args:
        model: The robot's model.
        qd_goal: Joint velocities, (6,) [rad/s].
        acceleration: Acceleration of the joint with the largest change [rad/s^2].
    """

    def __init__(self, model: ControllerModel, qd_goal: Array, acceleration: float) -> None:
        super().__init__()
        limit = np.array(model.velocity)
        self._goal = np.clip(qd_goal, -limit, limit)
        self._acceleration = min(acceleration, model.acceleration)
        self._speed: Array | None = None  # at a full slider

    def replan(self) -> None:
        """Accelerate from standstill."""
        self._speed = None

    def reached(self) -> bool:
        """Whether the velocities are reached."""
        return self._speed is not None and bool(np.all(self._speed == self._goal))

    def step(self, q: Array, qd: Array, scaled: float, dt: float) -> Array:  # noqa: ARG002
        if self._speed is None:
            self._speed = qd * (dt / scaled) if scaled > 1e-3 * dt else np.zeros(6)
        self._speed = approach(self._speed, self._goal, self._acceleration * dt)
        return self._speed * scaled


def approach(value: Array, goal: Array, most: float) -> Array:
    """Move a vector straight towards another one.

    Args:
        value: The vector, (N,).
        goal: Where it goes, (N,).
        most: Largest change of a component.

    Returns:
        The moved vector, (N,); the goal where that is near enough.
    """
    way = goal - value
    longest = float(np.abs(way).max())
    return goal if longest <= most else value + way * (most / longest)


class Trapezoid:
    """A trapezoidal velocity profile from rest to rest.

    Args:
        length: Length of the path.
        speed: Largest speed.
        acceleration: Acceleration and deceleration.
        duration: Duration [s] instead of speed and acceleration, a third of it for each phase; 0 for none.

    Attributes:
        length: Length of the path.
        duration: Duration [s].
    """

    def __init__(self, length: float, speed: float, acceleration: float, duration: float = 0.0) -> None:
        if duration > 0.0:
            speed, acceleration = 1.5 * length / duration, 4.5 * length / duration**2
        self.length = length
        self._peak = min(speed, sqrt(length * acceleration))
        self._acceleration = acceleration
        self._ramp = self._peak / acceleration if length > 0.0 else 0.0
        self.duration = self._ramp + length / self._peak if length > 0.0 else 0.0

    def at(self, time: float) -> float:
        """Length covered at `time` [s]."""
        left = self.duration - time
        if left <= 0.0:
            return self.length
        if time < self._ramp:
            return 0.5 * self._acceleration * time**2
        if left < self._ramp:
            return self.length - 0.5 * self._acceleration * left**2
        return self._peak * (time - 0.5 * self._ramp)

    def slowing(self, time: float) -> bool:
        """Whether it decelerates at `time` [s]."""
        return self.duration - time <= self._ramp


class Move(Motion):
    """A move from rest to rest, planned once the arm stands; a moving arm brakes first.

    Args:
        model: The robot's model.
        X_flange_tcp: Pose of the TCP in the flange frame, 4x4.
        acceleration: Deceleration of the braking [rad/s^2], limited by the model's.
        blend: Distance of the TCP from the end, while decelerating, at which the move counts as finished [m].

    Attributes:
        blending: Whether the next move may start.
    """

    def __init__(self, model: ControllerModel, X_flange_tcp: Array, acceleration: float, blend: float) -> None:
        super().__init__()
        self.blending = False
        self._model, self._X_flange_tcp, self._blend = model, X_flange_tcp, blend
        self._brake = Brake(min(max(acceleration, 0.1), model.acceleration))
        self._time, self._profile, self._q = 0.0, Trapezoid(0.0, 1.0, 1.0), np.zeros(6)
        self._planned = False

    def start(self, q: Array) -> None:
        """Plan from joint positions q (6,) [rad] at once: the end of the previous, blended move."""
        self._profile, self._q, self._planned = self._plan(q), q, True

    def replan(self) -> None:
        """Plan again, from where the arm stands to the same end."""
        self._time, self._planned = 0.0, False

    @property
    @abstractmethod
    def q_end(self) -> Array:
        """Joint positions at the end, (6,) [rad]."""

    @abstractmethod
    def _plan(self, q: Array) -> Trapezoid: ...

    @abstractmethod
    def _at(self, way: float, near: Array, dt: float) -> Array:
        """Joint positions (6,) [rad] at a path length; near: those of one tick of dt [s] before."""

    def step(self, q: Array, qd: Array, scaled: float, dt: float) -> Array:
        if not self._planned:
            if np.abs(qd).max() > STANDSTILL:
                return self._brake.step(q, qd, scaled, dt)
            self.start(q)
        self._time += scaled
        before, self._q = self._q, self._at(self._profile.at(self._time), self._q, dt)
        self.done = self._time >= self._profile.duration
        if self._blend > 0.0 and self._profile.slowing(self._time):
            self.blending = self._to_go() <= self._blend
        return self._q - before

    def _to_go(self) -> float:
        """Distance of the TCP from the end [m]."""
        here, end = (forward(self._model, q) @ self._X_flange_tcp for q in (self._q, self.q_end))
        return float(np.linalg.norm(end[:3, 3] - here[:3, 3]))


class JointMove(Move):
    """`movej`: moves all joints so that they start and stop together.

    Args:
        model: The robot's model.
        X_flange_tcp: Pose of the TCP in the flange frame, 4x4.
        q_goal: Goal, (6,) [rad].
        acceleration: Acceleration of the leading joint [rad/s^2].
        speed: Speed of the leading joint [rad/s].
        time: Duration [s] instead of speed and acceleration; 0 for none.
        blend: Distance of the TCP from the end at which the next move may start [m].
    """

    def __init__(
        self,
        model: ControllerModel,
        X_flange_tcp: Array,
        q_goal: Array,
        acceleration: float,
        speed: float,
        time: float,
        blend: float,
    ) -> None:
        super().__init__(model, X_flange_tcp, acceleration, blend)
        self._goal, self._speed, self._duration = q_goal, speed, time
        self._acceleration = min(acceleration, model.acceleration)
        self._from, self._direction = q_goal, np.zeros(6)

    @property
    def q_end(self) -> Array:
        """The goal, (6,) [rad]."""
        return self._goal

    def _plan(self, q: Array) -> Trapezoid:
        way = self._goal - q
        length = float(np.abs(way).max())
        self._from, self._direction = q, way / length if length > 0.0 else way
        share = np.abs(self._direction) / np.array(self._model.velocity)
        allowed = 1.0 / float(share.max()) if length > 0.0 else self._speed
        if self._duration > 0.0 and 1.5 * length > allowed * self._duration:
            raise MotionError(f"movej: {self._duration:.3f} s are too short for this path")
        return Trapezoid(length, min(self._speed, allowed), self._acceleration, self._duration)

    def _at(self, way: float, near: Array, dt: float) -> Array:  # noqa: ARG002
        return self._goal if way == self._profile.length else self._from + self._direction * way
