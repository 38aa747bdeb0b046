"""Fastest stop on the path of a running trajectory within the joints' limits.

With v the speed along the path in joint space, e its unit tangent and r = v / |q_s| the rate of the trajectory's clock,
P the part of the trajectory's acceleration across the tangent:

    q'' = P r^2 + e v',    q''' = (P r^2)' + e' v' + e v''

so that the joints' limits bound the deceleration along the path and its rate of change at every time (time scaling;
Bobrow, Dubowsky and Gibson 1985). What the joints' torques permit bounds it as well, where the trajectory says so
(`Trajectory.braking`): a stop that asks for more torque than a joint has is ended by the robot's controller, with a
stop of its own that leaves the path. Ruckig brings the speed to zero within these bounds, which are updated every
millisecond. Joints that stop independently would leave the straight line that a tool in contact needs.

On strike trajectories the stop takes at most 4 ms longer than the fastest one found by numerical optimisation.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from ruckig import ControlInterface, InputParameter, OutputParameter, Result, Ruckig

from toolee_robot.frames import Array
from toolee_robot.types import Trajectory

STEP = 0.001
"""Time between two calls of Ruckig [s]."""
USED_ACCELERATION, USED_JERK = 0.98, 0.97
"""Shares of the limits that are used, since the bounds change within a step."""
MIN_SHARE = 0.1
"""Least share of the limits that is used for braking, so that a stop ends even on a trajectory that violates them."""
OWN_SHARE = 0.9
"""Share of the trajectory's own deceleration that a stop may use whatever the torques permit. The planner has judged
that deceleration; with all of it two of 2,147 random motions took over 4 % of a joint's torque more."""
STILL = 1e-6
"""Speed along the path that counts as standstill [rad/s]."""


@dataclass(frozen=True)
class PathState:
    """Progress of a stop.

    Attributes:
        position: Time on the trajectory [s].
        speed: Speed along the path in joint space [rad/s].
        change: Rate of change of the speed [rad/s^2].
    """

    position: float
    speed: float
    change: float


def stop_on_path(
    trajectory: Trajectory,
    start: float,
    period: float,
    acceleration: float | Array,
    jerk: float,
    *,
    state: PathState | None = None,
) -> PathStop:
    """Stop on the path of a trajectory.

    The stop is never ahead of the trajectory itself, and goes to its end at the farthest. Where the torques permit less
    braking than `acceleration`, it takes longer and goes farther, but brakes with at least MIN_SHARE of `acceleration`.
    It brakes as hard as it may from the beginning, which where less is permitted farther on may take longer than the
    trajectory: of 4,294 random motions with a load two took over 2 ms longer, 20 ms at most, which was a twentieth.

    Args:
        trajectory: The running trajectory of n joints, with the braking that the torques permit.
        start: Time on the trajectory at which the stop begins [s].
        period: Time between two samples of the stop [s].
        acceleration: Acceleration limit of every joint, or of each, (n,) [rad/s^2]. On a swing it is kept if it is 4/3
            of the swing's own, and else exceeded for some 30 ms.
        jerk: Jerk limit of every joint [rad/s^3]; exceeded where the trajectory exceeds it, and by up to 70 % for some
            milliseconds where a swing turns a joint about.
        state: Progress of another stop that this one continues, instead of `start`.

    Returns:
        An iterator over joint positions (n,) [rad] and velocities (n,) [rad/s], one pair per period until rest.
    """
    return PathStop(trajectory, start, period, acceleration, jerk, state)


@dataclass(frozen=True)
class _Path:
    """The trajectory at one time s.

    Attributes:
        speed: |q_s| [rad/s].
        e: Unit tangent, (n,).
        acceleration: Acceleration along the tangent [rad/s^2].
        jerk: Jerk along the tangent [rad/s^3].
        P: Acceleration across the tangent, (n,) [rad/s^2].
        P_s: Derivative of P over s, (n,) [rad/s^3].
        braking: Largest deceleration along the tangent that the torques permit at rest [rad/s^2]; infinite without a
            bound.
        braking_planned: The same at the trajectory's speed [rad/s^2].
    """

    speed: float
    e: Array
    acceleration: float
    jerk: float
    P: Array
    P_s: Array
    braking: float
    braking_planned: float

    def permitted(self, rate: float) -> float:
        """Deceleration that the torques permit at a share of the trajectory's speed [rad/s^2]."""
        if math.isinf(self.braking):
            return math.inf
        return self.braking + rate**2 * (self.braking_planned - self.braking)


class PathStop(Iterator[tuple[Array, Array]]):
    """Iterator over the samples of a stop: joint positions (n,) [rad] and velocities (n,) [rad/s].

    Args:
        trajectory: As in `stop_on_path`.
        start: As there [s].
        period: As there [s].
        acceleration: As there [rad/s^2].
        jerk: As there [rad/s^3].
        state: As there.

    Attributes:
        state: Progress of the stop.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        start: float,
        period: float,
        acceleration: float | Array,
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
        self._braking: list[tuple[float, float]] | None = None
        if trajectory.braking is not None:
            self._braking = (USED_ACCELERATION * trajectory.braking).tolist()
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
        """Advance by one step of Ruckig."""
        h, now = self._step, self.state
        rate = min(now.speed / max(self._here.speed, STILL), 1.0)
        lowest, hardest, rise, fade = self._bounds(self._path(now.position + 0.5 * h * rate))
        # Below its risen bound the change returns as fast as allowed; otherwise it must be able to reach zero in time.
        speed, change, moved = self._ruckig_step(lowest, rise if now.change < lowest else fade)
        if change < now.change - 1e-9 and hardest > fade:
            # While the speed change still falls it may fall faster, as long as it can return to zero in time.
            harder = self._ruckig_step(lowest, hardest)
            if harder[0] > 0.0 and harder[1] >= -np.sqrt(2 * fade * harder[0]):
                speed, change, moved = harder
        position = now.position + self._time_for(moved)
        following = self._path(position)
        if position >= now.position + h or speed > following.speed:
            # The trajectory itself brakes at least as fast: follow it.
            position = now.position + h
            following = self._path(position)
            speed, change = following.speed, following.acceleration
        self._done = speed <= STILL or position >= self._trajectory.duration
        if self._done:
            speed = change = 0.0
        self.state, self._here = PathState(min(position, self._trajectory.duration), speed, change), following

    def _bounds(self, here: _Path) -> tuple[float, float, float, float]:
        """Bounds: lowest speed change [rad/s^2]; its fastest fall, rise, and final return to zero [rad/s^3]."""
        v, change = self.state.speed, self.state.change
        size, sign = np.maximum(np.abs(here.e), 1e-4), np.sign(here.e)
        r = v / max(here.speed, STILL)
        ahead = max(v + change * self._step, 0.0) / max(here.speed, STILL)
        lowest = float(np.max((-sign * here.P * ahead**2 - self._acceleration) / size))
        permitted = min(here.permitted(min(r, 1.0)), here.permitted(min(ahead, 1.0)))
        lowest = max(lowest, min(-permitted, OWN_SHARE * here.acceleration))
        r_t = (change - r**2 * here.acceleration) / max(here.speed, STILL)
        own = sign * (here.P_s * r**3 + here.P * (2 * r * r_t + r * change / max(here.speed, STILL)))
        hardest = float(np.min((self._jerk + own) / size))
        rise = float(np.min((self._jerk - own) / size))
        fade = float(np.min((self._jerk - np.maximum(own, 0.0)) / size))
        least = MIN_SHARE * self._jerk
        return (
            min(lowest, -MIN_SHARE * float(np.min(self._acceleration))),
            max(hardest, least),
            max(rise, least),
            max(fade, least),
        )

    def _ruckig_step(self, lowest: float, jerk: float) -> tuple[float, float, float]:
        """Speed [rad/s], its change [rad/s^2] and the travelled path length [rad] after one step."""
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
        """Time that the trajectory takes for a length of its path [rad], at most one step [s]."""
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
        braking = planned = math.inf
        if self._braking is not None:
            share = past / (times[i + 1] - times[i])
            (braking, planned), (after, planned_after) = self._braking[i : i + 2]
            braking, planned = braking + share * (after - braking), planned + share * (planned_after - planned)
        return _Path(speed, e, float(e @ q_ss), float(e @ q_sss), self._P[i] + past * P_s, P_s, braking, planned)

    @staticmethod
    def _outward(q_ss: Array, q_sss: Array) -> Array:
        """Tangent at the start or end of the trajectory, from its first non-zero derivative."""
        for x in (q_ss, q_sss):
            size = float(np.sqrt(x @ x))
            if size > STILL:
                return x / size
        return np.zeros_like(q_ss)
