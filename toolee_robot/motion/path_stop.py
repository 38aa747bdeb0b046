"""Stop on the path of a running trajectory, within the joints' limits, as fast as they allow.

With v the speed along the path in joint space, e its unit tangent and r = v / |q_s| the rate of the trajectory's clock,
P the part of the trajectory's acceleration across the tangent:

    q'' = P r^2 + e v',    q''' = (P r^2)' + e' v' + e v''

so that at every moment the joints' limits bound how the speed may fall and how that fall may change (time scaling;
Bobrow, Dubowsky and Gibson 1985). Ruckig takes the speed to zero within these bounds, asked anew every millisecond.
Joints that stop each for themselves would leave the straight line that a tool in contact needs.

On strike trajectories the stop takes at most 4 ms longer than the fastest one found by numerical optimisation.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from ruckig import ControlInterface, InputParameter, OutputParameter, Result, Ruckig

from toolee_robot.frames import Array
from toolee_robot.types import Trajectory

STEP = 0.001
"""[s] between two calls of Ruckig."""
USED_ACCELERATION, USED_JERK = 0.98, 0.97
"""Shares of the limits that are used: the bounds move on within a step."""
MIN_SHARE = 0.1
"""Share of the limits that brakes in any case: a stop ends even where a trajectory itself breaks them."""
STILL = 1e-6
"""[rad/s] along the path: standstill."""


@dataclass(frozen=True)
class PathState:
    """A stop under way: position, time on the trajectory [s]; speed along the path in joint space [rad/s] and its
    change [rad/s^2]."""

    position: float
    speed: float
    change: float


def stop_on_path(
    trajectory: Trajectory,
    start: float,
    period: float,
    acceleration: float,
    jerk: float,
    *,
    state: PathState | None = None,
) -> PathStop:
    """q, qd (n,) each `period` [s], from time `start` [s] on the trajectory to rest; nothing at its end.

    acceleration [rad/s^2] and jerk [rad/s^3] bound every joint; where the trajectory itself breaks them the stop goes
    on all the same. state: of another stop that is under way, which this one takes over (instead of `start`). It is
    never slower than the trajectory, and ends at the trajectory's end at the latest.
    """
    return PathStop(trajectory, start, period, acceleration, jerk, state)


@dataclass(frozen=True)
class _Path:
    """The trajectory at one time: speed |q_s|, tangent e, along e: acceleration and jerk; across e: acceleration P and
    its slope over s."""

    speed: float
    e: Array
    acceleration: float
    jerk: float
    P: Array
    P_s: Array


class PathStop(Iterator[tuple[Array, Array]]):
    """A stop under way; `state` tells how far it has come."""

    def __init__(
        self,
        trajectory: Trajectory,
        start: float,
        period: float,
        acceleration: float,
        jerk: float,
        state: PathState | None = None,
    ) -> None:
        self._trajectory = trajectory
        self._acceleration, self._jerk = USED_ACCELERATION * acceleration, USED_JERK * jerk
        speed = np.linalg.norm(trajectory.qd, axis=1)
        e = trajectory.qd / np.maximum(speed, STILL)[:, None]
        across = trajectory.qdd - np.sum(e * trajectory.qdd, axis=1)[:, None] * e
        self._P = np.where(speed[:, None] > STILL, across, 0.0)
        self._times: list[float] = trajectory.times.tolist()
        lengths = np.diff(trajectory.times)[:, None]
        self._q_sss, self._P_s = np.diff(trajectory.qdd, axis=0) / lengths, np.diff(self._P, axis=0) / lengths
        self._here = self._path(start if state is None else state.position)
        self.state = PathState(start, self._here.speed, self._here.acceleration) if state is None else state
        self._steps = max(1, round(period / STEP))
        self._step = period / self._steps
        self._ruckig, self._output = Ruckig(1, self._step), OutputParameter(1)
        self._input = InputParameter(1)
        self._input.control_interface = ControlInterface.Velocity
        self._input.current_position = self._input.target_velocity = self._input.target_acceleration = [0.0]
        self._input.max_velocity = [1e3]
        self._done = self.state.position >= trajectory.duration

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> tuple[Array, Array]:
        if self._done:
            raise StopIteration
        for _ in range(self._steps):
            self._advance()
            if self._done:
                break
        q, _ = self._trajectory.sample(self.state.position)
        return q, self._here.e * self.state.speed

    def _advance(self) -> None:
        """One step of Ruckig."""
        h, now = self._step, self.state
        rate = min(now.speed / max(self._here.speed, STILL), 1.0)
        lowest, hardest, rise, fade = self._bounds(self._path(now.position + 0.5 * h * rate))
        # Below its bound, which has risen, the change comes back as fast as it may; else it must be able to fade.
        speed, change, moved = self._ruckig_step(lowest, rise if now.change < lowest else fade)
        if change < now.change - 1e-9 and hardest > fade:
            # Falling still: it may fall harder than it must fade, as long as it can fade in time.
            harder = self._ruckig_step(lowest, hardest)
            if harder[0] > 0.0 and harder[1] >= -np.sqrt(2 * fade * harder[0]):
                speed, change, moved = harder
        position = now.position + self._time_for(moved)
        following = self._path(position)
        if position >= now.position + h or speed > following.speed:
            # The trajectory is no slower to brake: as it does.
            position = now.position + h
            following = self._path(position)
            speed, change = following.speed, following.acceleration
        self._done = speed <= STILL or position >= self._trajectory.duration
        if self._done:
            speed = change = 0.0
        self.state, self._here = PathState(min(position, self._trajectory.duration), speed, change), following

    def _bounds(self, here: _Path) -> tuple[float, float, float, float]:
        """The lowest change of the speed [rad/s^2]; how fast the change may fall and rise now, and fade at the end
        [rad/s^3]."""
        v, change = self.state.speed, self.state.change
        size, sign = np.maximum(np.abs(here.e), 1e-4), np.sign(here.e)
        r = v / max(here.speed, STILL)
        ahead = max(v + change * self._step, 0.0) / max(here.speed, STILL)
        lowest = float(np.max((-sign * here.P * ahead**2 - self._acceleration) / size))
        r_t = (change - r**2 * here.acceleration) / max(here.speed, STILL)
        own = sign * (here.P_s * r**3 + here.P * (2 * r * r_t + r * change / max(here.speed, STILL)))
        hardest = float(np.min((self._jerk + own) / size))
        rise = float(np.min((self._jerk - own) / size))
        fade = float(np.min((self._jerk - np.maximum(own, 0.0)) / size))
        least = MIN_SHARE * self._jerk
        return min(lowest, -MIN_SHARE * self._acceleration), max(hardest, least), max(rise, least), max(fade, least)

    def _ruckig_step(self, lowest: float, jerk: float) -> tuple[float, float, float]:
        """Speed, change and the length of path [rad] one step on."""
        given, now = self._input, self.state
        given.current_velocity, given.current_acceleration = [now.speed], [now.change]
        given.min_acceleration, given.max_acceleration = [lowest], [max(-lowest, now.change)]
        given.max_jerk = [jerk]
        result = self._ruckig.update(given, self._output)
        out = self._output
        if result not in (Result.Working, Result.Finished):
            speed = max(now.speed + lowest * self._step, 0.0)
            return speed, lowest, 0.5 * (now.speed + speed) * self._step
        return max(out.new_velocity[0], 0.0), out.new_acceleration[0], max(out.new_position[0], 0.0)

    def _time_for(self, length: float) -> float:
        """How long the trajectory takes from here [s] for a length of its path [rad], a step at most."""
        v, a, j = self._here.speed, self._here.acceleration, self._here.jerk
        t = self._step
        for _ in range(6):  # Newton, from above
            slope = v + t * (a + 0.5 * t * j)
            if slope < STILL:
                break
            t -= (t * (v + t * (a / 2 + t * j / 6)) - length) / slope
            t = min(max(t, 0.0), self._step)
        return t

    def _path(self, s: float) -> _Path:
        t, times = self._trajectory, self._times
        i = min(max(bisect_right(times, s) - 1, 0), len(times) - 2)
        past = min(max(s, 0.0), times[-1]) - times[i]
        q_sss = self._q_sss[i]
        q_ss = t.qdd[i] + past * q_sss
        q_s = t.qd[i] + (0.5 * past) * (t.qdd[i] + q_ss)
        speed = float(np.sqrt(q_s @ q_s))
        e = q_s / speed if speed > STILL else self._outward(q_ss, q_sss)
        P_s = self._P_s[i]
        return _Path(speed, e, float(e @ q_ss), float(e @ q_sss), self._P[i] + past * P_s, P_s)

    @staticmethod
    def _outward(q_ss: Array, q_sss: Array) -> Array:
        """The tangent where the trajectory begins or ends: that of what moves it away."""
        for x in (q_ss, q_sss):
            size = float(np.sqrt(x @ x))
            if size > STILL:
                return x / size
        return np.zeros_like(q_ss)
