"""The motion of `servoj`: following a stream of joint positions."""

from __future__ import annotations

from math import sqrt

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel
from toolee_robot.sim_backend.ur_controller.robot.motion import Motion, approach


class ServoJ(Motion):
    """`servoj`: moves the joints evenly to a goal, reached after a given time, and holds it.

    The velocity is (goal - set-point) / remaining time, so a stream of set-points, each due one tick later, is followed
    exactly, with a lag of one tick. lookahead_time and gain do not filter, while a real arm lags by about its
    lookahead. A goal that would exceed the model's acceleration or velocity, or that stands still, is approached within
    those limits, relative to the velocity of the goal, and without overshoot except for acceleration * dt^2 / 8; an arm
    that is already too fast passes it and returns. A goal that stands still for a tick because a packet was late costs
    one or two ticks until the stream is followed again.

    If limits apply, the velocity of all joints changes along one line in joint space, in proportion to the joint with
    the largest change. A real servoj, with one gain and one lookahead for all joints, has an error that shrinks along
    one line, too, and the Script Manual describes stopj as "linear in joint space".

    Args:
        model: The robot's model.
        q_goal: Goal, (6,) [rad].
        time: Time after which it is due [s].
    """

    stays = True

    def __init__(self, model: ControllerModel, q_goal: Array, time: float) -> None:
        super().__init__()
        self._goal, self._left = q_goal, time
        self._velocity, self._acceleration = np.array(model.velocity), model.acceleration
        self._standing = False
        self._since, self._goal_speed = 0.0, np.zeros(6)

    def follow(self, before: Motion) -> None:
        """Replace the previous `servoj`.

        The same goal stands still; another one is assumed to continue at the velocity with which it moved since its
        last change.
        """
        if not isinstance(before, ServoJ):
            return
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
        """Scale the velocity of all joints to the velocity limits."""
        return speed / max(1.0, float((np.abs(speed) / self._velocity).max()))
