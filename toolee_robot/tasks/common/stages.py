"""Durations of the stages of a job."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import Stage


class Stages:
    """Measures the duration of stages, each of which may occur several times.

    Args:
        observer: Receives the start and the end of every stage.

    Attributes:
        seconds: Total wall-clock time of each stage [s].
        latest: The stage that the job is in or was in last, before it parked the tool; None before the first one.
    """

    def __init__(self, observer: TaskObserver) -> None:
        self.seconds: dict[str, float] = {}
        self.latest: Stage | None = None
        self._observer = observer

    @contextmanager
    def __call__(self, stage: Stage) -> Iterator[None]:
        """Context of one occurrence of a stage."""
        began = time.perf_counter()
        if stage is not Stage.PARK:
            self.latest = stage
        self._observer.stage_started(stage)
        try:
            yield
        finally:
            seconds = time.perf_counter() - began
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds
            self._observer.stage_ended(stage, seconds)
