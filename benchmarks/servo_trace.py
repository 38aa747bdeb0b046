"""Comparison of the sent commands with the joints of the controller stand-in: lost commands, lag, tracking."""

from __future__ import annotations

import mmap
import os
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel, JointPlant

_ROW = np.dtype([("stamp", np.float64), ("q", np.float64, 6)])
_LATEST = 6  # cycles within which a command must have reached the robot
_SETTLING = 5 * _LATEST  # cycles that the joints need to catch up, after what was late
_EXACT = 1e-6  # [rad]
_TRANSIT = 5e-4
"""Largest time from sending a command to the joints having moved [s]: transmission and the tick's work, 0.2 to 0.5 ms
on two cores. A command sent later before a tick may or may not be in time for it."""


@dataclass(frozen=True)
class TraceFigures:
    """Results of the comparison.

    Attributes:
        ticks: Number of the robot's ticks during the motion.
        lag: Median time from sending a command to the joints having moved [s].
        lag_error: Largest deviation of the joints from the command of that lag, over the `followed` ticks [rad].
        followed: Share of the ticks that are compared: all but those near an irregular, late or close tick or a late
            command, and those in which the robot executes an older command than usual.
        held: Number of ticks without a new command.
        skipped: Number of commands that a later one overtook before they were executed.
        unreported: Number of held ticks and skipped commands without an explanation: near no command that was sent late
            (by half a cycle), no tick of the stand-in that was late (by a quarter) or close, and no joints that still
            catch up after one. A skipped command that only ends the delay of a held one does not count.
        late_ticks: Number of the stand-in's ticks that were late by a quarter of a cycle or more.
        close_ticks: Number of ticks whose command was sent too shortly before, or after: neither driver nor stand-in
            was late enough alone, but both together were.
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
    """Times and joint positions after each tick, in an anonymous file that the stand-in's plant writes.

    The stand-in inherits the file (see `RecordedJoints`). It is not queried during the measurement, since an answer
    between two ticks would delay a command to the tick after the next.
    """

    def __init__(self, ticks: int) -> None:
        self.fd = os.memfd_create("toolee-trace")
        os.truncate(self.fd, ticks * _ROW.itemsize)
        _rows(self.fd)[:] = 0.0  # map every page in advance

    def read(self) -> tuple[Array, Array]:
        """Return the stamps, (N,) [s], and joint positions, (N, 6) [rad], of all ticks so far."""
        rows = _rows(self.fd)
        written = rows[rows["stamp"] > 0.0]
        return written["stamp"].copy(), written["q"].copy()

    def close(self) -> None:
        """Close the file."""
        os.close(self.fd)


class RecordedJoints(JointPlant):
    """Ideal joints that write a row of a `TraceMemory` per tick."""

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
    """Compare the commands of a motion with the trace of the joints."""
    period = 1.0 / rate
    sent, commanded = report.stamps, report.q_commanded
    # Without the settling at the end, where all commands are equal.
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
    # Joints that catch up are between two commands, so that the nearest one does not identify the executed command.
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
