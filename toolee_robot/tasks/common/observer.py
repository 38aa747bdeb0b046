"""What a task tells those who watch: terminal, recorder, tests. Watching never changes the job."""

from __future__ import annotations

from toolee_robot.control.records import StrikePlan
from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport
from toolee_robot.tasks.common.outcome import HammerResult, Stage, Strike
from toolee_robot.types import InHandEstimate, RgbdFrame, ToolEstimate


class TaskObserver:
    """Base of the observers: override what is of interest. Stamps [s] are on the station's clock."""

    def stage_started(self, stage: Stage) -> None:
        """A stage begins."""

    def stage_ended(self, stage: Stage, seconds: float) -> None:
        """A stage is over after `seconds` of wall-clock time."""

    def message(self, text: str) -> None:
        """A sentence for the person at the station."""

    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:
        """A frame was taken and this is what perception saw in it."""

    def in_hand(self, stamp: float, estimate: InHandEstimate) -> None:
        """The frames of a look were fused."""

    def planned(self, stamp: float, plan: StrikePlan) -> None:
        """A strike was planned."""

    def motion(self, name: str, report: MotionReport, hand_joints: Array) -> None:
        """The arm moved; hand_joints are those measured after it."""

    def contact(self, stamp: float, force: float, X_base_ee: Array) -> None:
        """The face met something: sensed force [N] and where the robot believes the EE is."""

    def strike(self, strike: Strike) -> None:
        """A strike is done and measured."""

    def ended(self, result: HammerResult) -> None:
        """The job is over; the arm stands still."""


class Observers(TaskObserver):
    """Fans every call out to several observers, in order."""

    def __init__(self, *observers: TaskObserver) -> None:
        self._observers = observers

    def stage_started(self, stage: Stage) -> None:
        for o in self._observers:
            o.stage_started(stage)

    def stage_ended(self, stage: Stage, seconds: float) -> None:
        for o in self._observers:
            o.stage_ended(stage, seconds)

    def message(self, text: str) -> None:
        for o in self._observers:
            o.message(text)

    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:
        for o in self._observers:
            o.frame(frame, estimates, X_camera_hand)

    def in_hand(self, stamp: float, estimate: InHandEstimate) -> None:
        for o in self._observers:
            o.in_hand(stamp, estimate)

    def planned(self, stamp: float, plan: StrikePlan) -> None:
        for o in self._observers:
            o.planned(stamp, plan)

    def motion(self, name: str, report: MotionReport, hand_joints: Array) -> None:
        for o in self._observers:
            o.motion(name, report, hand_joints)

    def contact(self, stamp: float, force: float, X_base_ee: Array) -> None:
        for o in self._observers:
            o.contact(stamp, force, X_base_ee)

    def strike(self, strike: Strike) -> None:
        for o in self._observers:
            o.strike(strike)

    def ended(self, result: HammerResult) -> None:
        for o in self._observers:
            o.ended(result)
