"""Events of a task for its observers (terminal, recorder, tests), which never influence it; durations of its stages."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import Any

from toolee_robot.control.records import StrikePlan
from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport
from toolee_robot.tasks.common.outcome import HammerResult, NailResult, Stage, Strike
from toolee_robot.types import InHandEstimate, RgbdFrame, ToolEstimate

HandCourse = Sequence[tuple[float, Array]]


class TaskObserver:
    """Base class of the observers, whose methods do nothing. Stamps are seconds on the station's clock."""

    def stage_started(self, stage: Stage) -> None:
        """Called when a stage begins."""

    def stage_ended(self, stage: Stage, seconds: float) -> None:
        """Called when a stage ends.

        Args:
            stage: The stage.
            seconds: Its wall-clock time [s].
        """

    def message(self, text: str) -> None:
        """Called with a message for the person at the station."""

    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:
        """Called when a frame was taken and evaluated.

        Args:
            frame: The frame.
            estimates: The end effectors in it, in the camera frame.
            X_camera_hand: Pose of the hand in the camera frame at the exposure, (4, 4).
        """

    def in_hand(self, stamp: float, estimate: InHandEstimate) -> None:
        """Called when the frames of a look were fused.

        Args:
            stamp: Time of the fusion [s].
            estimate: Pose of the end effector in the hand.
        """

    def planned(self, stamp: float, plan: StrikePlan) -> None:
        """Called when a strike was planned.

        Args:
            stamp: Time of the plan [s].
            plan: The plan.
        """

    def motion(self, name: str, report: MotionReport, hand: HandCourse) -> None:
        """Called after a motion of the arm.

        Args:
            name: Name of the motion.
            report: What was commanded and measured.
            hand: Joint positions of the hand in the motion, (n,) [rad], by time [s]; one of a hand that holds no tool.
        """

    def contact(self, stamp: float, force: float, X_base_ee: Array) -> None:
        """Called when the face met something.

        Args:
            stamp: Time of the contact [s].
            force: Sensed force [N].
            X_base_ee: Estimated pose of the end effector in `base`, (4, 4).
        """

    def nail_started(self, name: str, protrusion: float) -> None:
        """Called before the first look for a nail.

        Args:
            name: Its name.
            protrusion: Height of its head over the wood, as far as is known [m].
        """

    def nail_ended(self, result: NailResult) -> None:
        """Called when the job is done with a nail, or gives it up."""

    def strike(self, strike: Strike) -> None:
        """Called when a strike on the nail started last was executed and measured."""

    def ended(self, result: HammerResult) -> None:
        """Called when the job has ended and the arm stands still."""


class Observers(TaskObserver):
    """Forwards every event to several observers, in order."""

    def __init__(self, *observers: TaskObserver) -> None:
        self._observers = observers


def _to_all(event: str) -> Callable[..., None]:
    @wraps(getattr(TaskObserver, event))
    def tell(self: Observers, *args: Any) -> None:
        for observer in self._observers:
            getattr(observer, event)(*args)

    return tell


for _event in [name for name in vars(TaskObserver) if not name.startswith("_")]:
    setattr(Observers, _event, _to_all(_event))


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
