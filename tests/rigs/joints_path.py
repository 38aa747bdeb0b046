"""Motion of the joints after a fault, from the stand-in's trace rather than from the driver's report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from toolee_robot.control.motion.path_stop import stop_on_path
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.faults.client import Trace
from toolee_robot.station import ArmLimits
from toolee_robot.types import Trajectory

MOVING = 2e-3  # [rad/s]
RESOLUTION = 2e-4  # [s] on the trajectory
SLOWER = 0.95  # of the uninterrupted progress in a tick: the motion has changed
REST_TICKS = 10


@dataclass(frozen=True)
class Stop:
    """The stop after a fault.

    Attributes:
        path_time: Time on the trajectory at the fault [s].
        speed: Speed of the fastest joint at the fault [rad/s].
        reaction: Time from the fault to the first change of the motion [s]; None without one.
        standstill: Time from the fault to rest [s].
        off_path: Largest deviation of the joints from the path [rad].
        reached: Furthest time on the trajectory that was reached [s].
    """

    path_time: float
    speed: float
    reaction: float | None
    standstill: float
    off_path: float
    reached: float


def stop_after(trace: Trace, trajectory: Trajectory, event: float) -> Stop:
    """Analyse the stop after a fault.

    The path is that of the controller's set-point, with the lag of its servo, which the stand-in's joints follow
    exactly and which neither noise nor a sensor fault changes; speeds are those of the joints, without noise.
    """
    i = int(np.searchsorted(trace.stamps, event))
    if not 0 < i < len(trace.stamps) - 1:
        raise DeviceError("the stand-in's trace does not cover the fault: it came before or after the motion")
    fastest = np.abs(trace.qd).max(axis=1)
    moving = np.flatnonzero(fastest > MOVING)
    last = int(moving[-1]) if len(moving) else 0
    if last > len(fastest) - REST_TICKS:
        raise DeviceError(f"the arm still moves {trace.stamps[-1] - event:.2f} s after the fault")
    times, distance = projected(trace.q_target, trajectory)
    progress = np.diff(times, prepend=times[0])
    period = float(np.median(np.diff(trace.stamps)))
    changed = np.flatnonzero((progress[i:] < SLOWER * period) & (times[i:] < trajectory.duration - period))
    return Stop(
        path_time=float(times[i - 1]),
        speed=float(fastest[i - 1]),
        reaction=float(trace.stamps[i + changed[0]] - event) if len(changed) else None,
        standstill=max(float(trace.stamps[min(last + 1, len(fastest) - 1)] - event), 0.0),
        off_path=float(distance[i - 1 :].max()),
        reached=float(times.max()),
    )


def braking_time(path: Trajectory, start: float, period: float, limits: ArmLimits) -> float:
    """Compute the shortest duration of a stop on a path."""
    return period * len(list(stop_on_path(path, start, period, limits.stop_acceleration, limits.stop_jerk)))


def projected(q: Array, trajectory: Trajectory) -> tuple[Array, Array]:
    """Project joint positions on a trajectory."""
    grid = np.linspace(0.0, trajectory.duration, max(2, round(trajectory.duration / RESOLUTION)))
    dense = np.stack([np.interp(grid, trajectory.times, column) for column in trajectory.q.T], axis=1)
    distance, index = cKDTree(dense).query(q)
    return grid[index], distance
