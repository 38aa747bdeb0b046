"""What every task with a handed tool shares: its begin and its ends, resuming after a stop, the way home.

A task says what it does with the tool (`_work`), and what its result is (`result`). Every job ends with an `Outcome`
and a reason; every exception leaves the arm at a standstill.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from datetime import date
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from toolee_robot.control.planning.transfer import plan_transfer
from toolee_robot.errors import (
    DeviceError,
    GripError,
    NotReadyError,
    PerceptionError,
    PersonNearError,
    PlanningError,
    WeighingError,
)
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.look import Look
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.outcome import PUT_AWAY, TAKE_OUT, JobEnded, Outcome, Stage, Stops, TaskResult

if TYPE_CHECKING:
    from toolee_robot.tasks.hammering.handover import Handover  # a task brings its own

STOPPED = (Outcome.DEVICE_FAULT, Outcome.PERSON_NEAR)
"""Outcomes after which a job may be resumed."""
R = TypeVar("R", bound=TaskResult)
Ending = tuple[Outcome, str]
"""How a job ended, and why."""


class HandedTask(ABC, Generic[R]):
    """A job with a tool that a person hands over, to the parked arm.

    Args:
        motions: The arm and its motions.
        handover: How the tool comes into the hand.
        tool: What messages call the tool.
        goes_on: What the arm does after a job was resumed, for a prompt.
    """

    def __init__(self, motions: Motions, handover: Handover, tool: str, goes_on: str) -> None:
        self._station, self._config, self._motions = motions.station, motions.config, motions
        self._handing, self._tool, self._goes_on = handover, tool, goes_on
        self._stops = Stops()
        self._outcome: Outcome | None = None
        self._fault: DeviceError | None = None
        self._began = self._station.clock.now()

    @abstractmethod
    def result(self, outcome: Outcome, reason: str) -> R:
        """Build the record of the job as far as it went, for instance after an interruption.

        Args:
            outcome: How the job ended.
            reason: Why, for a person.

        Returns:
            The record.
        """

    @abstractmethod
    def _work(self, held: HeldTool, *, resumed: bool) -> Ending:
        """Do with the held tool what the task is about, to its end."""

    @abstractmethod
    def _tell_ended(self, result: R) -> None:
        """Tell the observer of the result."""

    def _facts(self, look: Look | None) -> dict[str, Any]:
        """What every task's result has beside outcome and reason, by the names of `TaskResult`."""
        return {
            "stage": self._motions.stages.latest,
            "estimates": () if look is None else tuple(look.estimates),
            "stage_seconds": dict(self._motions.stages.seconds),
            "robot_seconds": self._station.clock.now() - self._began,
            "stops": self._stops.count,
            "fault": self._fault,
        }

    def _told(self, reason: str) -> str:
        """The reason of an ending, with what the task adds to it."""
        return reason

    def _leave_work(self, held: HeldTool | None) -> None:
        """Bring the tool to where a transfer may begin."""
        self._motions.rise_from_among_nails(held)

    def run(self) -> R:
        """Do the job and park the arm.

        Only programming errors and KeyboardInterrupt propagate, after arm and hand have stopped with the grip kept.

        Returns:
            The result of the job.
        """
        self._began = self._station.clock.now()
        return self._end(self._job)

    def resume(self, *, confirmed: bool = False) -> R:
        """Go on with a job that was stopped with the tool in the hand: reset, then look at the tool again.

        Args:
            confirmed: Whether a person has looked at robot, hand and tool, and has made the robot ready where it had
                stopped itself.

        Returns:
            The result of the job. A robot that is not ready is not reset: the job then ends as it had, and can be
            resumed later.

        Raises:
            NotReadyError: There is nothing to resume; code `not_ready.nothing_to_resume`.
            DeviceError: Nobody has confirmed it; code `device.reset_not_confirmed`.
        """
        if not self.resumable:
            raise NotReadyError(
                "no stopped job holds a tool and can go on. Run a new one", code="not_ready.nothing_to_resume"
            )
        if not confirmed:
            raise DeviceError(
                "a person resumes a job after looking at the robot. Confirm that",
                code="device.reset_not_confirmed",
            )
        try:
            self._motions.arm.reset(confirmed=True)
            self._motions.begin()
        except DeviceError as error:
            self._motions.stand_still()
            return self._ended(Outcome.DEVICE_FAULT, f"the stop cannot be cleared yet: {error}; {TAKE_OUT}")
        return self._end(self._go_on)

    def give_back(self) -> bool:
        """Let a person take the tool out of the hand, after every stop, also a latched one; the arm does not move.

        Returns:
            Whether the person confirmed that they hold the tool, and the hand was opened.

        Raises:
            DeviceError: The hand did not open.
        """
        return self._handing.give_back()

    @property
    def resumable(self) -> bool:
        """Whether the job was stopped with the tool in the hand and may go on after a person has looked."""
        return self.holds_tool and self._outcome in STOPPED and not self._stops.last

    @property
    def holds_tool(self) -> bool:
        """Whether the tool is in the hand as far as is known."""
        return self._motions.carried is not None

    @property
    def latched(self) -> str:
        """The fault that stopped the arm in this job and has not been reset; empty if none."""
        return self._motions.arm.latched

    def _end(self, job: Callable[[], Ending]) -> R:
        """Run a job to its end, whatever ends it."""
        self._fault = None
        try:
            outcome, reason = self._ending(job)
            outcome, reason = self._park(outcome, self._told(reason))
        except BaseException:
            self._motions.stand_still()
            raise
        return self._ended(outcome, reason)

    def _ended(self, outcome: Outcome, reason: str) -> R:
        self._outcome = outcome
        result = self.result(outcome, reason)
        self._tell_ended(result)
        return result

    def _ending(self, job: Callable[[], Ending]) -> Ending:
        try:
            return job()
        except JobEnded as end:
            return end.outcome, str(end)
        except PersonNearError as error:
            self._motions.stand_still()
            self._fault = error
            return Outcome.PERSON_NEAR, str(error)
        except PerceptionError as error:
            return Outcome.POSE_UNKNOWN, str(error)
        except WeighingError as error:
            return Outcome.WEIGHT_UNKNOWN, str(error)
        except PlanningError as error:
            return Outcome.NO_PLAN, str(error)
        except GripError as error:
            self._motions.stand_still()
            return Outcome.TOOL_LOST, f"{error}; {self._after_loss()}"
        except DeviceError as error:
            self._motions.stand_still()
            self._fault = error
            return Outcome.DEVICE_FAULT, str(error)

    def _job(self) -> Ending:
        self._check_calibration()
        self._motions.begin()
        return self._work(self._handing.take_tool(), resumed=False)

    def _go_on(self) -> Ending:
        self._motions.check_hand()
        self._handing.clear_person(f"Step back. The arm looks at the {self._tool} again, then {self._goes_on}.")
        held = self._handing.tell_payload(self._motions.held)
        return self._work(held.forgotten(), resumed=True)

    def _after_loss(self) -> str:
        """Once a person has looked, and asked for it, move the arm away from where the tool may lie."""
        prompt = (
            f"The hand has lost the {self._tool}, and the arm stands still. Find the {self._tool}. Confirm, then hold "
            "the hold-to-run switch: the arm moves up and away slowly."
        )
        if not self._motions.person.confirm_inspection(prompt, self._config.task.handover_timeout):
            return f"nobody allowed the arm to move away: {PUT_AWAY}"
        self._handing.tool_gone()
        return f"the arm moved away from it: {PUT_AWAY}" if self._motions.retreat() else PUT_AWAY

    def _check_calibration(self) -> None:
        """Refuse a station whose camera calibration is missing or invalid."""
        calibration = self._config.calibration
        if calibration is None:
            raise JobEnded(Outcome.NOT_READY, "the station is not calibrated. Calibrate it and enter the result")
        station = self._station
        problems = calibration.problems(station.robot_serial, station.camera_serial, date.today())
        if problems:
            raise JobEnded(Outcome.NOT_READY, "the calibration is not valid: " + "; ".join(problems))

    def _park(self, outcome: Outcome, reason: str) -> Ending:
        """Bring the arm home with the tool still in the hand.

        The arm stays in place when a device has failed, the tool was dropped at an unknown place, a person may be
        within reach, or no safe motion was found.
        """
        if outcome is Outcome.NOT_READY:
            return outcome, f"{reason}; nothing was moved"
        if outcome is Outcome.TOOL_LOST:
            return outcome, reason
        if outcome is Outcome.WEIGHT_UNKNOWN:
            return outcome, f"{reason}; {TAKE_OUT}"
        if outcome in STOPPED:
            if not self.holds_tool:
                return outcome, f"{reason}; {PUT_AWAY}"
            return outcome, self._stops.add(reason)
        with self._motions.stages(Stage.PARK):
            try:
                if not self._handing.person_clear:
                    self._handing.clear_person("Take the tool with you and step back. The arm goes home.")
                home = np.asarray(self._config.scene.home)
                held = self._motions.carried
                self._leave_work(held)
                world = self._motions.world(held)
                way = plan_transfer(self._motions.robot, self._config, world, self._motions.q, home)
                self._motions.transfer("home", way, held)
            except (PlanningError, DeviceError) as error:
                self._motions.stand_still()
                reason = f"{reason}; the arm stands where it stopped: {error}"
        return outcome, reason
