"""Time parametrisation with Ruckig: jerk-limited motion of the joints, and along the length of a line."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from ruckig import InputParameter, Result, Ruckig
from ruckig import Trajectory as RuckigTrajectory

from toolee_robot.errors import LimitError
from toolee_robot.frames import Array
from toolee_robot.types import Trajectory

SAMPLE_PERIOD = 0.004
"""Sample period of trajectories [s]: twice the rate of a CB3 arm, half of that of an e-Series arm."""


@dataclass(frozen=True)
class PathProfile:
    """Motion along the length of a path, sampled at N times.

    Attributes:
        times: Times of the samples, (N,) [s].
        s: Positions along the path, (N,) [m].
        v: Speeds, (N,) [m/s].
        a: Accelerations, (N,) [m/s^2].
    """

    times: Array
    s: Array
    v: Array
    a: Array


def travel_profile(start: float, end: float, speed: float, acceleration: float, jerk: float) -> PathProfile:
    """Compute the motion from rest to rest.

    Args:
        start: Initial position along the path [m].
        end: Final position along the path [m].
        speed: Largest speed [m/s].
        acceleration: Largest acceleration [m/s^2].
        jerk: Largest jerk [m/s^3].

    Returns:
        The sampled motion.
    """
    parameters = _parameters(1, [speed], [acceleration], [jerk])
    parameters.current_position, parameters.target_position = [start], [end]
    return _path_samples(_calculate(parameters))


def joint_move(q_start: Array, q_end: Array, velocity: Array, acceleration: Array, jerk: Array) -> Trajectory:
    """Compute the synchronised motion of all joints from rest to rest, straight in joint space.

    All joints keep one ratio (Ruckig over one common path length), so the executed path is the one that was checked for
    collisions.

    Args:
        q_start: Initial joint positions, (n,) [rad].
        q_end: Final joint positions, (n,) [rad].
        velocity: Velocity limits, (n,) [rad/s].
        acceleration: Acceleration limits, (n,) [rad/s^2].
        jerk: Jerk limits, (n,) [rad/s^3].

    Returns:
        The trajectory.
    """
    change = q_end - q_start
    span = np.maximum(np.abs(change), 1e-12)
    limits = [float(np.min(limit / span)) for limit in (velocity, acceleration, jerk)]
    if np.max(np.abs(change)) < 1e-9:
        still = np.zeros((2, len(q_start)))
        return Trajectory(np.array([0.0, SAMPLE_PERIOD]), np.stack([q_start, q_start]), still, still.copy())
    path = travel_profile(0.0, 1.0, *limits)
    return Trajectory(
        path.times,
        q_start + path.s[:, None] * change,
        path.v[:, None] * change,
        path.a[:, None] * change,
    )


def concatenate(*trajectories: Trajectory) -> Trajectory:
    """Concatenate trajectories.

    Args:
        trajectories: The trajectories in order; each must begin where the previous one ends, to 1e-6 rad.

    Raises:
        ValueError: They do not join.
    """
    for before, after in itertools.pairwise(trajectories):
        if np.max(np.abs(before.q[-1] - after.q[0])) > 1e-6:
            raise ValueError("trajectories do not join: the second does not begin where the first ends")
    start, times = 0.0, []
    for i, trajectory in enumerate(trajectories):
        times.append(start + (trajectory.times if i == 0 else trajectory.times[1:]))
        start += trajectory.duration

    def join(name: str) -> Array:
        return np.concatenate([getattr(t, name)[min(i, 1) :] for i, t in enumerate(trajectories)])

    return Trajectory(np.concatenate(times), join("q"), join("qd"), join("qdd"))


def _parameters(n: int, velocity: list[float], acceleration: list[float], jerk: list[float]) -> InputParameter:
    parameters = InputParameter(n)
    parameters.max_velocity, parameters.max_acceleration, parameters.max_jerk = velocity, acceleration, jerk
    parameters.current_position = parameters.current_velocity = parameters.current_acceleration = [0.0] * n
    parameters.target_position = parameters.target_velocity = parameters.target_acceleration = [0.0] * n
    return parameters


def _calculate(parameters: InputParameter) -> RuckigTrajectory:
    trajectory = RuckigTrajectory(parameters.degrees_of_freedom)
    result = Ruckig(parameters.degrees_of_freedom).calculate(parameters, trajectory)
    if result not in (Result.Working, Result.Finished):
        raise LimitError(
            f"no time parametrisation within the limits: ruckig says {result}", code="limit.time_parametrisation"
        )
    return trajectory


def _path_samples(trajectory: RuckigTrajectory) -> PathProfile:
    """Sample a Ruckig trajectory; the last sample is exactly at its end."""
    count = max(2, int(np.ceil(trajectory.duration / SAMPLE_PERIOD)) + 1)
    times = np.linspace(0.0, trajectory.duration, count)
    s, v, a = (np.array(column)[:, 0] for column in zip(*(trajectory.at_time(t) for t in times), strict=True))
    return PathProfile(times, s, v, a)
