"""Motion of the joints after a fault, from the stand-in's trace rather than from the driver's report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from toolee_robot.control.motion.path_stop import stop_on_path
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import MotionWatch
from toolee_robot.sim_backend.devices.arm import RATE, SimArm
from toolee_robot.sim_backend.ur_controller.faults.fault_port import Trace
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.station import ArmLimits
from toolee_robot.types import Trajectory

MOVING = 2e-3  # [rad/s]
RESOLUTION = 2e-4  # [s] on the trajectory
SLOWER = 0.95  # of the uninterrupted progress in a tick: the motion has changed
REST_TICKS = 10


@dataclass(frozen=True)
class Stop:
    """The stop after a fault."""

    path_time: float
    speed: float
    reaction: float | None
    standstill: float
    off_path: float
    reached: float


def stop_after(trace: Trace, trajectory: Trajectory, event: float) -> Stop:
    """Analyse the stop after a fault."""
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


class JointWatch:
    """Records the true joints and the arm's set-point at every step of the simulation."""

    def __init__(self, world: SimWorld, arm: SimArm) -> None:
        self._world, self._arm = world, arm
        self._stamps: list[float] = []
        self._q: list[Array] = []
        self._qd: list[Array] = []
        self._target: list[Array] = []
        self._watching = False
        self._due: list[tuple[float, Callable[[], None]]] = []
        world.after_step.append(self._after_step)

    def begin(self) -> None:
        """Start recording."""
        self._watching = True
        self._note()

    def end(self) -> None:
        """End recording."""
        self._watching = False

    def at(self, stamp: float, act: Callable[[], None]) -> None:
        """Schedule a call in the first step that ends at a time or later."""
        self._due.append((stamp, act))

    def _after_step(self) -> None:
        if self._watching:
            self._note()
        for due in [d for d in self._due if self._world.time >= d[0]]:
            self._due.remove(due)
            due[1]()

    def _note(self) -> None:
        q, qd = self._world.robot.arm_state()
        self._stamps.append(self._world.time)
        self._q.append(q)
        self._qd.append(qd)
        self._target.append(self._arm.q_commanded)

    def stop(self, trajectory: Trajectory, event: float, *, commanded: bool = False) -> Stop:
        """Analyse the stop after a fault; path and reaction are those of the set-point."""
        target = np.array(self._target)
        trace = self._trace(target)
        if commanded:
            # Up to the last change one row is one cycle.
            change = np.diff(trace.q_target, axis=0, append=trace.q_target[-1:]) * RATE
            trace = replace(trace, qd=change)
        return stop_after(trace, trajectory, event)

    def off_path(self, trajectory: Trajectory, event: float) -> float:
        """Largest deviation of the true joints from the path after a fault."""
        return stop_after(self._trace(np.array(self._q)), trajectory, event).off_path

    def _trace(self, path: Array) -> Trace:
        """Build a trace with one row per cycle of the arm, extended by rest at its end."""
        stamps, target = np.array(self._stamps), np.array(self._target)
        # A set-point is to be reached at the end of its cycle, where the next one replaces it.
        replaced = np.abs(np.diff(target, axis=0)).max(axis=1) > 0.0
        ends = np.flatnonzero(replaced)
        if len(ends) == 0:
            ends = np.array([0])
        last = stamps[ends[-1]]
        settling = [int(np.searchsorted(stamps, t)) for t in np.arange(last + 1 / RATE, stamps[-1] + 1e-6, 1 / RATE)]
        rows = np.concatenate([ends, settling, np.full(REST_TICKS + 2, len(stamps) - 1)]).astype(int)
        rows = np.clip(rows, 0, len(stamps) - 1)
        resting = np.maximum(np.arange(len(rows)) - (len(rows) - REST_TICKS - 2), 0) / RATE
        ticks, none = np.arange(len(rows), dtype=float), np.zeros(len(rows))
        q, qd = np.array(self._q)[rows], np.array(self._qd)[rows]
        return Trace(ticks, stamps[rows] + resting, q, qd, path[rows], none, none, none)


PATIENT = MotionWatch(tracking_error=0.05, data_cycles=100.0, overruns=100)
"""Tolerates late data and late commands."""
CLOSE = replace(PATIENT, tracking_error=0.03)
"""For joints that are pushed back: at 2 rad/s each cycle of permitted lag hides 0.02 rad of it at 125 Hz."""
STRICT_AGE = replace(PATIENT, data_cycles=3.0)
"""For late data."""
SHORT_AGE = replace(PATIENT, data_cycles=10.0)
"""For connections that stay open without data."""
STRICT_LOOP = replace(PATIENT, tracking_error=0.3, overruns=3)
"""For late commands."""
