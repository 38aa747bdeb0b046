"""What was sent against what the controller stand-in's joints did: lost and doubled commands, lag, tracking."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport
from toolee_robot.sim_backend.ur_controller.fault_client import Trace

_POLL = 0.1  # [s]: the trace comes in pages small enough not to make a tick late
_LATEST = 6  # cycles within which a command must have reached the robot


@dataclass(frozen=True)
class TraceFigures:
    """ticks: of the robot during the motion. lag: the median time from sending to the joints being there [s].
    lag_error: the most that the joints were off the command so many ticks before, where none was lost [rad]. held:
    ticks without a new command; skipped: commands that a later one overtook; of both, those counted as unreported
    coincide neither with a cycle that the driver sent late (by half a cycle) nor with a tick of the stand-in that was
    late (by a quarter, which is what a command sent in the middle of a cycle leaves). late_ticks: those.
    """

    ticks: int
    lag: float
    lag_error: float
    held: int
    skipped: int
    unreported: int
    late_ticks: int


class TraceRecorder:
    """Collects a stand-in's trace in the background; it keeps only a minute or so itself."""

    def __init__(self, trace: Callable[[int], Trace], after: int) -> None:
        """trace: `ControllerProcess.trace`, which nobody else calls meanwhile. after: the tick to begin with."""
        self._trace, self._after = trace, after
        self._parts: list[Trace] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def finish(self) -> tuple[Array, Array]:
        """stamps (N,) and joints (N, 6) of all ticks so far."""
        self._ended.set()
        self._thread.join()
        self._collect()
        return np.concatenate([p.stamps for p in self._parts]), np.concatenate([p.q for p in self._parts])

    def _run(self) -> None:
        while not self._ended.wait(_POLL):
            self._collect()

    def _collect(self) -> None:
        part = self._trace(self._after)
        if len(part.ticks):
            self._after = int(part.ticks[-1])
            self._parts.append(part)


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
    excuses = np.sort(np.concatenate([late_sent, late_ticks]))
    unreported = sum(not _near(excuses, stamps[i], (_LATEST + 1) * period) for i in irregular)
    # After an irregular tick the joints need a few ticks to catch up.
    calm = np.ones(len(stamps), dtype=bool)
    for i in irregular:
        calm[i : i + 5 * _LATEST] = False
    return TraceFigures(
        ticks=len(stamps),
        lag=float(np.median(stamps - sent[k])),
        lag_error=float(error[calm].max()) if calm.any() else float("nan"),
        held=int(np.sum(steps == 0)),
        skipped=int(np.sum(np.maximum(steps - 1, 0))),
        unreported=int(unreported),
        late_ticks=len(late_ticks),
    )


def _near(events: Array, time: float, within: float) -> bool:
    i = int(np.searchsorted(events, time - within))
    return i < len(events) and bool(events[i] <= time + within)
