"""Recording of the simulated joints step by step, and actions at a chosen step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.rigs.joints_path import REST_TICKS, Stop, stop_after
from toolee_robot.frames import Array
from toolee_robot.sim_backend.devices.arm import RATE, SimArm
from toolee_robot.sim_backend.ur_controller.faults.client import Trace
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.types import Trajectory


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
