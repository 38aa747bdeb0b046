"""What was sent against what the controller stand-in's joints did: lost and doubled commands, lag, tracking."""

from __future__ import annotations

import mmap
import os
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport
from toolee_robot.sim_backend.ur_controller.robot.joint_plant import JointPlant
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel

_ROW = np.dtype([("stamp", np.float64), ("q", np.float64, 6)])
_LATEST = 6  # cycles within which a command must have reached the robot
_SETTLING = 5 * _LATEST  # cycles that the joints need to catch up, after what was late
_EXACT = 1e-6  # [rad]
_TRANSIT = 5e-4
"""[s] From sending a command to the joints being there, at most: its way and the tick's own work, which took 0.2 to 0.5
ms on two cores. What is sent later may or may not be in time."""


@dataclass(frozen=True)
class TraceFigures:
    """ticks: of the robot during the motion. lag: the median time from sending to the joints being there [s].
    lag_error: the most that the joints were off the command of that lag, in the share `followed` of the ticks: all but
    those about an irregular, late or close one or a command that was sent late, and those in which the robot goes by an
    older command than usual [rad]. held: ticks without a new command; skipped: commands that a later one overtook.
    unreported: of the held, and of the skipped that do not just end the lateness which a held one began, those that
    coincide neither with a cycle that the driver sent late (by half a cycle) nor with a tick of the stand-in that was
    late (by a quarter, which is what a command sent in the middle of a cycle leaves) or close, nor show joints that
    still catch up after one. late_ticks: those. close_ticks: those whose command was sent too shortly before to be
    there for sure, or after: alone neither the driver nor the stand-in was late enough, together they were.
    """

    ticks: int
    lag: float
    lag_error: float
    followed: float
    held: int
    skipped: int
    unreported: int
    late_ticks: int
    close_ticks: int


class TraceMemory:
    """When and where the joints were after each tick: an anonymous file that the stand-in inherits and its plant writes
    (`RecordedJoints`). Nothing is asked of the stand-in while it is measured: an answer between two ticks would have a
    command wait for the tick after the next."""

    def __init__(self, ticks: int) -> None:
        self.fd = os.memfd_create("toolee-trace")
        os.truncate(self.fd, ticks * _ROW.itemsize)
        _rows(self.fd)[:] = 0.0  # every page is there before it is needed

    def read(self) -> tuple[Array, Array]:
        """stamps (N,) [s] and joints (N, 6) of all ticks so far."""
        rows = _rows(self.fd)
        written = rows[rows["stamp"] > 0.0]
        return written["stamp"].copy(), written["q"].copy()

    def close(self) -> None:
        os.close(self.fd)


class RecordedJoints(JointPlant):
    """Ideal joints that start at q (6,) and write a row of the `TraceMemory` of the file descriptor `fd` a tick."""

    def __init__(self, model: ControllerModel, q: Array, fd: int) -> None:
        super().__init__(model, q)
        self._rows, self._tick = _rows(fd), 0

    def step(self, dt: float) -> None:
        super().step(dt)
        if self._tick < len(self._rows):
            self._rows[self._tick] = (time.monotonic(), self.q)
            self._tick += 1


def _rows(fd: int) -> NDArray[np.void]:
    return np.frombuffer(mmap.mmap(fd, 0), dtype=_ROW)


def compare(report: MotionReport, stamps: Array, q: Array, rate: float) -> TraceFigures:
    """report: of a motion in which no two commands are alike. stamps (N,) [s], q (N, 6): the trace. rate [Hz]."""
    period = 1.0 / rate
    sent, commanded = report.stamps, report.q_commanded
    # Not the settling at its end, where all commands are alike.
    moving = int(np.flatnonzero(np.abs(np.diff(commanded, axis=0)).max(axis=1) > 0)[-1]) + 1
    sent, commanded = sent[:moving], commanded[:moving]
    inside = (stamps > sent[0] + _LATEST * period) & (stamps < sent[-1])
    stamps, q = stamps[inside], q[inside]
    newest = np.searchsorted(sent, stamps) - 1
    candidates = np.clip(newest[:, None] - np.arange(_LATEST), 0, None)
    errors = np.abs(commanded[candidates] - q[:, None]).max(axis=2)
    best = errors.argmin(axis=1)
    ticks = np.arange(len(stamps))
    k, error = candidates[ticks, best], errors[ticks, best]
    steps = np.diff(k)
    irregular = np.flatnonzero(steps != 1) + 1
    late_sent = sent[1:][np.abs(np.diff(sent) - period) >= period / 2]
    late_ticks = stamps[1:][np.abs(np.diff(stamps) - period) >= period / 4]
    since = stamps - sent[newest]
    close_ticks = stamps[(since < _TRANSIT) | (since >= period)]
    excuses = np.sort(np.concatenate([late_sent, late_ticks, close_ticks]))
    behind = newest - k
    behind -= int(np.median(behind))
    # Joints that catch up are between two commands, and the nearest one says little of which they were given.
    between = error > _EXACT
    unreported = sum(
        not _near(excuses, stamps[i], (_SETTLING if between[i - 1 : i + 1].any() else _LATEST + 1) * period)
        for i in irregular
        if steps[i - 1] < 1 or behind[i - 1] <= 0
    )
    calm = behind == 0
    for i in (*irregular, *np.searchsorted(stamps, excuses)):
        calm[max(i - _LATEST, 0) : i + _SETTLING] = False
    return TraceFigures(
        ticks=len(stamps),
        lag=float(np.median(stamps - sent[k])),
        lag_error=float(error[calm].max()) if calm.any() else float("nan"),
        followed=float(calm.mean()),
        held=int(np.sum(steps == 0)),
        skipped=int(np.sum(np.maximum(steps - 1, 0))),
        unreported=int(unreported),
        late_ticks=len(late_ticks),
        close_ticks=len(close_ticks),
    )


def _near(events: Array, time: float, within: float) -> bool:
    i = int(np.searchsorted(events, time - within))
    return i < len(events) and bool(events[i] <= time + within)
