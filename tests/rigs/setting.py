"""One controller under which faults are injected: its model and profile, and what it adds to the driver's own times.

A stop by the driver ends when the last command of the stop is reached. An ideal controller reaches it a tick later; a
harsh one follows with its lag, rounds the path off, and comes to rest after its commands do. How much later follows
from the law of its servo and the commands of the fastest permitted stop: they are computed and followed here, tick by
tick, and nothing is added.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.rigs.joints_path import MOVING, braking_time, projected
from toolee_robot.control.motion.path_stop import stop_on_path
from toolee_robot.devices.ur.servo.motion import tracking_error
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.profile import (
    Profile,
    ProfileName,
    SafetyLimits,
    ServoLag,
    StopDecelerations,
)
from toolee_robot.sim_backend.ur_controller.profile import profile as profile_of
from toolee_robot.sim_backend.ur_controller.robot.machine import RATE_SLEW
from toolee_robot.sim_backend.ur_controller.robot.motion import Motion
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS, ControllerModel, JointPlant
from toolee_robot.sim_backend.ur_controller.robot.servoj import servoj
from toolee_robot.station import ArmLimits, ServoConfig, servo_lag
from toolee_robot.types import ArmModel, Trajectory

GAIN, LOOKAHEAD = 1200.0, 0.03
"""Of servoj on a harsh controller: those for which a lag was measured, on a UR10e (UR client library, issue 86)."""
TRANSPORT_CYCLES = 2
"""Of a command to the controller and of its data back, beside the servo's own lag."""
AFTER = 1.0  # [s] for which the last command of a stop is held


@dataclass(frozen=True)
class Setting:
    """A controller stand-in and the driver's settings for it."""

    model: ArmModel
    host: str
    profile: ProfileName = "ideal"

    @property
    def controller(self) -> ControllerModel:
        """The stand-in's model."""
        return MODELS[self.model.value]

    @property
    def values(self) -> Profile:
        """The profile's values for this model."""
        return profile_of(self.profile, self.controller.e_series)

    @property
    def name(self) -> str:
        """As the matrix shows it."""
        return f"{self.model.value}, {self.controller.rate:.0f} Hz, {self.profile}"

    @property
    def period(self) -> float:
        """Cycle of arm and controller [s]."""
        return self.controller.period

    @property
    def stops(self) -> StopDecelerations:
        """Decelerations of the controller's own stops."""
        return self.values.stops

    @property
    def lag(self) -> float:
        """Lag of the servo with the driver's gain and lookahead [s]; 0 for an ideal one."""
        servo = self.values.servo
        return 0.0 if servo is None else servo.lag(GAIN, LOOKAHEAD, self.period)

    @property
    def servo(self) -> ServoConfig:
        """The driver's settings, with the lag that `toolee arm lag` would measure there."""
        return ServoConfig(gain=GAIN, lookahead=LOOKAHEAD, lag=self.lag + TRANSPORT_CYCLES * self.period)

    @property
    def servo_bound(self) -> float:
        """Upper bound of the servo's lag that the driver allows for [s]."""
        return servo_lag(self.servo, self.controller.rate)

    def start(self, q: Array, limits: SafetyLimits | None = None) -> ControllerProcess:
        """Make the stand-in, to be entered as a context."""
        plant = _Plant(tuple(float(angle) for angle in q))
        return ControllerProcess(
            model=self.model.value, host=self.host, profile=self.profile, limits=limits, plant=plant, realtime=True
        )

    def braking(
        self,
        path: Trajectory,
        path_time: float,
        notice: float,
        limits: ArmLimits,
        *,
        slider: float = 1.0,
        lag: ServoLag | None = None,
    ) -> float:
        """The time from the first command of the fastest permitted stop on a path until the joints stand."""
        if self.values.servo is None and slider == 1.0 and lag is None:
            return braking_time(path, path_time + notice, self.period, limits)
        fault = self._command_time(path, path_time)
        start = fault + notice
        before = _samples(path, start, self.period)
        stop = [q for q, _ in stop_on_path(path, start, self.period, limits.stop_acceleration, limits.stop_jerk)]
        commands = np.vstack([before, *stop])
        commands = np.vstack([commands, np.repeat(commands[-1:], round(AFTER / self.period), axis=0)])
        followed = self._followed(commands, round(fault / self.period), slider, lag)
        speed = np.abs(np.diff(followed, axis=0)).max(axis=1) / self.period
        moving = np.flatnonzero(speed > MOVING)
        last = int(moving[-1]) + 1 if len(moving) else 0
        return max((last + 1 - len(before)) * self.period, 0.0)

    def noticing(self, path: Trajectory, path_time: float, tolerance: float, lag: ServoLag) -> float:
        """The time from a servo's new lag until the joints are further from their commands than the driver allows."""
        fault = self._command_time(path, path_time)
        commands = _samples(path, path.duration, self.period)
        sent = np.arange(len(commands), dtype=np.float64) * self.period
        first = round(fault / self.period)
        for k, q in enumerate(self._followed(commands, first, 1.0, lag)):
            if k > first and tracking_error(sent, commands, sent[k], q, self.servo_bound) > tolerance:
                return float(sent[k]) - fault
        return path.duration - fault

    def rounding(self, path: Trajectory, lag: ServoLag | None = None) -> float:
        """How far the servo's lag takes the joints off a path that they are sent along."""
        exact = self.values.servo is None and lag is None
        return 0.0 if exact else float(self._lagging(path, lag)[1].max())

    def straight_on(self, path: Trajectory, start: float, notice: float, deceleration: float) -> float:
        """How far a stop of the controller's own leaves a path: it brakes straight on, and the path is curved."""
        points = []
        for time in np.arange(start, start + notice + self.period, self.period):
            q, qd = (np.array([np.interp(time, path.times, c) for c in columns.T]) for columns in (path.q, path.qd))
            stop = np.linspace(0.0, np.abs(qd).max() / deceleration, 20)
            points += [q + qd * (t - 0.5 * t * t / max(stop[-1], 1e-9)) for t in stop]
        return float(projected(np.array(points), path)[1].max())

    def _command_time(self, path: Trajectory, path_time: float) -> float:
        """Time on the path of the command in force when the joints are at `path_time` [s]."""
        if self.values.servo is None:
            return path_time
        times, _ = self._lagging(path)
        return float(np.searchsorted(np.maximum.accumulate(times), path_time)) * self.period

    def _lagging(self, path: Trajectory, lag: ServoLag | None = None) -> tuple[Array, Array]:
        """Where the joints are in each tick of a path: times on it, (N,) [s], and distances from it, (N,) [rad]."""
        commands = _samples(path, path.duration + AFTER, self.period)
        return projected(self._followed(commands, 0, 1.0, lag), path)

    def _followed(self, commands: Array, fault: int, slider: float, lag: ServoLag | None) -> Array:
        """Where the joints go with a command a tick, (N, 6) [rad]; slider and lag change in tick `fault`."""
        controller, servo, dt = self.controller, self.values.servo, self.period
        q, qd, rate = commands[0].copy(), np.zeros(6), 1.0
        last: Motion | None = None
        found = []
        for k, goal in enumerate(commands):
            if k >= fault:
                servo = lag or servo
                rate += max(-RATE_SLEW * dt, min(RATE_SLEW * dt, slider - rate))
            motion = servoj(controller, servo, goal, dt, self.servo.lookahead, self.servo.gain)
            if last is not None:
                motion.follow(last)
            last = motion
            way = motion.step(q, qd, rate * dt, dt)
            q, qd = q + way, way / dt
            found.append(q)
        return np.array(found)


@dataclass(frozen=True)
class _Plant:
    """Creates the joints in the stand-in's process."""

    q: tuple[float, ...]

    def __call__(self, model: ControllerModel) -> JointPlant:
        return JointPlant(model, np.array(self.q))


def _samples(path: Trajectory, end: float, period: float) -> Array:
    """Commands of a path up to a time, one a cycle, (N, 6) [rad]."""
    times = np.arange(max(round(end / period), 1) + 1) * period
    return np.stack([np.interp(times, path.times, column) for column in path.q.T], axis=1)
