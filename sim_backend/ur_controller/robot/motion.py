"""Motions in joint space, and what all motions share. A motion says, tick by tick, how far the joints go.

Ways add up: a blended move runs out while the next one already starts. Accelerations are those asked for, capped by
the model's; no motion has a jerk limit.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import sqrt

import numpy as np

from toolee_robot.errors import TooleeError
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot.kinematics import forward
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel

STANDSTILL = 1e-9  # [rad/s]


class MotionError(TooleeError):
    """The arm cannot do this motion."""


class Motion(ABC):
    """done: nothing more to come. stays: goes on by itself when the script function that began it is over."""

    stays = False

    def __init__(self) -> None:
        self.done = False

    @abstractmethod
    def step(self, q: Array, qd: Array, scaled: float, dt: float) -> Array:
        """The way (6,) [rad] of one tick of dt [s], from the set-point q, qd (6,).

        scaled [s]: dt, slowed down by slider and pause. Raises MotionError when the arm cannot follow.
        """


class Brake(Motion):
    """To rest along the present direction in joint space, whatever slider and pause say.

    deceleration [rad/s^2]: of the fastest joint.
    """

    stays = True

    def __init__(self, deceleration: float) -> None:
        super().__init__()
        self._deceleration = deceleration

    def speed(self, q: Array, qd: Array) -> float:  # noqa: ARG002  (a stopl looks at q)
        """What falls at the deceleration."""
        return float(np.abs(qd).max())

    def step(self, q: Array, qd: Array, scaled: float, dt: float) -> Array:  # noqa: ARG002
        speed = self.speed(q, qd)
        left = max(speed - self._deceleration * dt, 0.0)
        self.done = left <= STANDSTILL
        return np.zeros(6) if self.done else qd * (left / speed * dt)


class ServoJ(Motion):
    """`servoj`: the joints go evenly to q_goal (6,) [rad] and are there at the end of `time` [s], then wait there.

    The speed is (goal - set-point) / time left, so a stream of set-points, each due one tick later, is followed
    exactly: the servo's lag is the one tick. lookahead_time and gain do not filter (a real arm lags by about its
    lookahead). A goal that would take more than the model's acceleration or speed, or that stands still, is approached
    within those, relative to the speed of the goal itself, and without overshoot (but for a grain of acceleration
    dt^2 / 8); an arm that is already too fast for that passes it and comes back. A goal that stands still for a tick
    in a stream, because a packet was late, costs a tick or two until the stream is followed again.

    The joints share what they are short of: the speed of all of them changes along one line, at the real-time factor of
    the joint that has most to change. One gain and one lookahead for all joints, which is all that a real servoj has,
    make its error shrink along one line, too; the Script Manual has stopj, in the same words, "linear in joint
    space"."""

    stays = True

    def __init__(self, model: ControllerModel, q_goal: Array, time: float) -> None:
        super().__init__()
        self._goal, self._left = q_goal, time
        self._velocity, self._acceleration = np.array(model.velocity), model.acceleration
        self._standing = False
        self._since, self._goal_speed = 0.0, np.zeros(6)

    def follow(self, before: ServoJ) -> None:
        """Takes the place of this one: the same goal stands still, another one moves on as fast as it came here since
        it last changed."""
        self._standing = bool(np.all(self._goal == before._goal))
        if self._standing:
            self._since = before._since
        elif before._since > 0.0:
            self._goal_speed = self._within((self._goal - before._goal) / before._since)

    def step(self, q: Array, qd: Array, scaled: float, dt: float) -> Array:
        way = self._goal - q
        share = 1.0 if self._left <= dt * (1 + 1e-6) else dt / self._left
        wanted = way * (share * (scaled / dt) / dt)
        change = self._acceleration * dt
        too_hard = float(np.abs(wanted - qd).max()) > change * (1 + 1e-9)
        too_fast = bool(np.any(np.abs(wanted) > self._velocity))
        careful = too_hard or too_fast or self._standing or self._left < 0.5 * dt
        self._left -= scaled
        self._since += scaled
        if not careful:
            return wanted * dt
        ahead = self._goal_speed
        behind = float(np.abs(way - ahead * dt).max())
        brakable = sqrt(2 * self._acceleration * behind + (change / 2) ** 2) - change / 2
        calm = self._within(approach(ahead, wanted, brakable))
        return approach(qd, calm, change) * dt

    def _within(self, speed: Array) -> Array:
        """Slowed down, all joints alike, to what the fastest joint may."""
        return speed / max(1.0, float((np.abs(speed) / self._velocity).max()))


class SpeedJ(Motion):
    """`speedj`: to the joint speeds qd_goal (6,) [rad/s], the joint that has the longest way at `acceleration`."""

    def __init__(self, model: ControllerModel, qd_goal: Array, acceleration: float) -> None:
        super().__init__()
        limit = np.array(model.velocity)
        self._goal = np.clip(qd_goal, -limit, limit)
        self._acceleration = min(acceleration, model.acceleration)
        self._speed: Array | None = None  # at a full slider

    def reached(self) -> bool:
        return self._speed is not None and bool(np.all(self._speed == self._goal))

    def step(self, q: Array, qd: Array, scaled: float, dt: float) -> Array:  # noqa: ARG002
        if self._speed is None:
            self._speed = qd * (dt / scaled) if scaled > 1e-3 * dt else np.zeros(6)
        self._speed = approach(self._speed, self._goal, self._acceleration * dt)
        return self._speed * scaled


def approach(value: Array, goal: Array, most: float) -> Array:
    """value moved straight towards goal; no component changes by more than `most`."""
    way = goal - value
    longest = float(np.abs(way).max())
    return goal if longest <= most else value + way * (most / longest)


class Trapezoid:
    """A way of a length from rest to rest: `speed` at most, `acceleration` at both ends; duration [s]."""

    def __init__(self, length: float, speed: float, acceleration: float, duration: float = 0.0) -> None:
        """duration: takes the place of speed and acceleration if it is not 0: a third each way up, even and down."""
        if duration > 0.0:
            speed, acceleration = 1.5 * length / duration, 4.5 * length / duration**2
        self.length = length
        self._peak = min(speed, sqrt(length * acceleration))
        self._acceleration = acceleration
        self._ramp = self._peak / acceleration if length > 0.0 else 0.0
        self.duration = self._ramp + length / self._peak if length > 0.0 else 0.0

    def at(self, time: float) -> float:
        """How far it is at `time` [s]."""
        left = self.duration - time
        if left <= 0.0:
            return self.length
        if time < self._ramp:
            return 0.5 * self._acceleration * time**2
        if left < self._ramp:
            return self.length - 0.5 * self._acceleration * left**2
        return self._peak * (time - 0.5 * self._ramp)

    def slowing(self, time: float) -> bool:
        return self.duration - time <= self._ramp


class Move(Motion):
    """From rest to rest on a way that is planned once the arm stands still (a moving arm brakes first).

    blend [m]: the move counts as finished at this distance of the TCP from its end, as soon as it slows down.
    """

    def __init__(self, model: ControllerModel, X_flange_tcp: Array, acceleration: float, blend: float) -> None:
        super().__init__()
        self.blending = False
        self._model, self._X_flange_tcp, self._blend = model, X_flange_tcp, blend
        self._brake = Brake(min(max(acceleration, 0.1), model.acceleration))
        self._time, self._profile, self._q = 0.0, Trapezoid(0.0, 1.0, 1.0), np.zeros(6)
        self._planned = False

    def start(self, q: Array) -> None:
        """Plan from q (6,) at once: the end of the move that runs out."""
        self._profile, self._q, self._planned = self._plan(q), q, True

    @property
    @abstractmethod
    def q_end(self) -> Array:
        """Where it ends (6,) [rad]."""

    @abstractmethod
    def _plan(self, q: Array) -> Trapezoid: ...

    @abstractmethod
    def _at(self, way: float, near: Array, dt: float) -> Array:
        """Joints (6,) at this length on the way; near: one tick of dt [s] before."""

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
        """Of the TCP to the end [m]."""
        here, end = (forward(self._model, q) @ self._X_flange_tcp for q in (self._q, self.q_end))
        return float(np.linalg.norm(end[:3, 3] - here[:3, 3]))


class JointMove(Move):
    """`movej`: all joints start and stop together; speed [rad/s] and acceleration [rad/s^2] are the leading joint's."""

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
        return self._goal

    def _plan(self, q: Array) -> Trapezoid:
        way = self._goal - q
        length = float(np.abs(way).max())
        self._from, self._direction = q, way / length if length > 0.0 else way
        share = np.abs(self._direction) / np.array(self._model.velocity)
        allowed = 1.0 / float(share.max()) if length > 0.0 else self._speed
        if self._duration > 0.0 and 1.5 * length > allowed * self._duration:
            raise MotionError(f"movej: {self._duration:.3f} s are too short for this way")
        return Trapezoid(length, min(self._speed, allowed), self._acceleration, self._duration)

    def _at(self, way: float, near: Array, dt: float) -> Array:  # noqa: ARG002
        return self._goal if way == self._profile.length else self._from + self._direction * way
