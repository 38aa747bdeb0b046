"""`servoj` as a real controller executes it: targets are smoothed and followed with a lag."""

from __future__ import annotations

from collections import deque
from functools import lru_cache
from math import cos, cosh, exp, sin, sinh, sqrt

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import ServoLag
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel
from toolee_robot.sim_backend.ur_controller.robot.motion import Motion

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
