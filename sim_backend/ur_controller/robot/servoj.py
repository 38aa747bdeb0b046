"""The motion of `servoj`: exact, or smoothed and with a lag, as a real controller executes it."""

from __future__ import annotations

from collections import deque
from functools import lru_cache
from math import cos, cosh, exp, sin, sinh, sqrt

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import ServoLag
from toolee_robot.sim_backend.ur_controller.robot.motion import Motion, approach
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel


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


LOOKAHEAD = (0.03, 0.2)
"""Range of lookahead_time [s] in the Script Manual; values outside are taken as the nearest one inside."""
GAIN = (100.0, 2000.0)
"""Range of gain in the Script Manual, likewise."""


class LaggingServoJ(Motion):
    """`servoj` with gain and lookahead_time.

    The Script Manual says that the gain "works the same way as the P-term of a PID controller", that a low
    lookahead_time "gives fast reaction, a high value prevents overshoot", and that a high gain or a short one "may
    cause instability and vibrations"; the control law is not published. Here it is

        x' = (goal(t - dead_time) - x) / (smoothing * lookahead_time)
        v' = (rate * gain * (x - q) - v) / velocity_lag,   q' = v

    which is stable for every gain and lookahead_time, lags by the sum of its time constants, and overshoots a step
    where the gain is high and the lookahead short. Slider and speed scaling scale its time, as Universal Robots
    document for the duration of servoj ("Trajectory improvements for servoj()"): at a half the lag doubles. The time
    of the call, t, only tells how long the script waits.

    Where the model's acceleration or velocity does not suffice, all joints share what there is.

    Args:
        model: The robot's model.
        servo: The lag.
        q_goal: Goal, (6,) [rad].
        lookahead: `lookahead_time` [s].
        gain: `gain`.
    """

    stays = True

    def __init__(self, model: ControllerModel, servo: ServoLag, q_goal: Array, lookahead: float, gain: float) -> None:
        super().__init__()
        self._servo, self._goal = servo, q_goal
        self._smoothing = servo.smoothing * min(max(lookahead, LOOKAHEAD[0]), LOOKAHEAD[1])
        self._rate = servo.rate * min(max(gain, GAIN[0]), GAIN[1])
        self._velocity, self._acceleration = np.array(model.velocity), model.acceleration
        self._delayed: deque[Array] = deque(maxlen=1 + round(servo.dead_time / model.period))
        self._x: Array | None = None  # the smoothed goal; None before the first tick and after a pause
        self._v = np.zeros(6)

    def follow(self, before: Motion) -> None:
        """Replace the previous `servoj`: the same filter goes on with another goal."""
        if isinstance(before, LaggingServoJ):
            self._x, self._v = before._x, before._v
            self._delayed.extend(before._delayed)

    def replan(self) -> None:
        """Start again from where the arm stands."""
        self._x = None
        self._delayed.clear()

    def step(self, q: Array, qd: Array, scaled: float, dt: float) -> Array:  # noqa: ARG002
        self._delayed.append(self._goal)
        if self._x is None:
            self._x, self._v = q, qd
        if scaled <= 0.0:
            return np.zeros(6)
        late = len(self._delayed) == self._delayed.maxlen
        if late:  # before that no goal has taken effect
            self._x = self._x + (scaled / (self._smoothing + scaled)) * (self._delayed[0] - self._x)
        qq, qv, vq, vv = _transition(self._rate, self._servo.velocity_lag, round(scaled, 9))
        error = q - self._x
        speed = vq * error + vv * self._v
        change = speed - self._v
        share = self._acceleration * scaled / max(float(np.abs(change).max()), 1e-12)
        way = self._x + qq * error + qv * self._v - q
        if share < 1.0:
            speed = self._v + share * change
            way = 0.5 * scaled * (self._v + speed)
        excess = float((np.abs(way) / self._velocity).max()) / scaled
        if excess > 1.0:
            speed, way = speed / excess, way / excess
        self._v = speed
        return way


@lru_cache(maxsize=256)
def _transition(rate: float, lag: float, dt: float) -> tuple[float, float, float, float]:
    """Exact transition of (position error, velocity) over dt [s] towards a constant goal, row by row."""
    half = 0.5 / lag
    discriminant = half * half - rate / lag
    w = sqrt(abs(discriminant))
    if w * dt < 1e-9:
        c, s = 1.0, dt
    elif discriminant < 0.0:
        c, s = cos(w * dt), sin(w * dt) / w
    else:
        c, s = cosh(w * dt), sinh(w * dt) / w
    e = exp(-half * dt)
    return e * (c + s * half), e * s, -e * s * rate / lag, e * (c - s * half)


def servoj(
    model: ControllerModel, servo: ServoLag | None, q_goal: Array, time: float, lookahead: float, gain: float
) -> Motion:
    """The motion of one call of `servoj`.

    Args:
        model: The robot's model.
        servo: The controller's lag; None for none.
        q_goal: Goal, (6,) [rad].
        time: Time after which it is due [s].
        lookahead: `lookahead_time` [s].
        gain: `gain`.

    Returns:
        The motion.
    """
    if servo is None:
        return ServoJ(model, q_goal, time)
    return LaggingServoJ(model, servo, q_goal, lookahead, gain)
