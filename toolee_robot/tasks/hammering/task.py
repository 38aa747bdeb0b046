"""The hammering job: take the tool, look at it, strike until every nail is flush, park the arm.

A state machine over the hardware abstraction. Its inputs are the station file, the camera's frames and the sensors of
arm and hand. Every job ends with an `Outcome` and a reason; every exception leaves the arm at a standstill. A job that
was stopped with the tool in the hand can go on after a person has looked:

    result = task.run()
    while task.resumable and a_person_looked_and_confirmed():
        result = task.resume(confirmed=True)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import date

import numpy as np

from toolee_robot.control.planning.transfer import plan_transfer
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.end_effectors import Category
from toolee_robot.errors import (
    DeviceError,
    GripError,
    NotReadyError,
    PerceptionError,
    PersonNearError,
    PlanningError,
    UserError,
    WeighingError,
)
from toolee_robot.hal import Station
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.look import Look, Perceiver
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import PUT_AWAY, TAKE_OUT, HammerResult, JobEnded, Outcome, Stage, Stops
from toolee_robot.tasks.hammering.grasp import Grasp
from toolee_robot.tasks.hammering.handover import Handover
from toolee_robot.tasks.hammering.nail_series import NailSeries

STOPPED = (Outcome.DEVICE_FAULT, Outcome.PERSON_NEAR)
"""Outcomes after which a job may be resumed."""


class HammeringTask:
    """One hammering job, from the handover to the parked arm.

    Args:
        station: The devices of the station.
        perceiver: Estimates the tool's pose from frames; usually a `ToolPerception`. None strikes with the nominal pose
            in the hand, which is the paper's baseline, for comparison only.
        config: Configuration of the station.
        grasp: Nominal grasp of the tool that will be handed over.
        observer: Receives the events of the job; None for no observer.
        nails: Names of the nails to drive, in order; None for all of the station.

    Raises:
        UserError: A face of which nothing is known is to be struck with where it nominally is (`user.unknown_face`).
    """

    def __init__(
        self,
        station: Station,
        perceiver: Perceiver | None,
        config: StationConfig,
        grasp: Grasp,
        *,
        observer: TaskObserver | None = None,
        nails: Sequence[str] | None = None,
    ) -> None:
        if grasp.ee_off and perceiver is None:
            raise UserError(
                "the tool's face is unknown, so it cannot strike without a look at it. Give tool.face and "
                "tool.face_normal, or leave --variant no_correction out",
                code="user.unknown_face",
            )
        names = tuple(nails or config.work.names)
        self._stops = Stops()
        self._station, self._config = station, config
        self._motions = motions = Motions(station, config, RobotModel.of_station(config), observer or TaskObserver())
        self._look = None if perceiver is None else Look(motions, perceiver, Category.HAMMER_HEAD)
        self._handover = Handover(motions, grasp, names)
        self._nails = NailSeries(motions, self._look, names)
        self._outcome: Outcome | None = None
        self._fault: DeviceError | None = None
        self._began = station.clock.now()

    def run(self) -> HammerResult:
        """Do the job and park the arm.

        Only programming errors and KeyboardInterrupt propagate, after arm and hand have stopped with the grip kept.

        Returns:
            The result of the job.
        """
        self._began = self._station.clock.now()
        return self._end(self._job)

    def resume(self, *, confirmed: bool = False) -> HammerResult:
        """Go on with a job that was stopped with the tool in the hand: reset, look at the tool again, measure the nail.

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
        return self._handover.give_back()

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

    def result(self, outcome: Outcome, reason: str) -> HammerResult:
        """Build the record of the job as far as it went, for instance after an interruption.

        Args:
            outcome: How the job ended.
            reason: Why, for a person.

        Returns:
            The record.
        """
        return HammerResult(
            outcome,
            reason,
            self._nails.strikes,
            self._nails.protrusion,
            stage=self._motions.stages.latest,
            estimates=() if self._look is None else tuple(self._look.estimates),
            stage_seconds=dict(self._motions.stages.seconds),
            robot_seconds=self._station.clock.now() - self._began,
            nail_seconds=self._nails.seconds,
            nails=self._nails.results(outcome, reason),
            stops=self._stops.count,
            fault=self._fault,
            weight=self._handover.weight,
        )

    def _end(self, job: Callable[[], tuple[Outcome, str]]) -> HammerResult:
        """Run a job to its end, whatever ends it."""
        self._fault = None
        try:
            outcome, reason = self._ending(job)
            outcome, reason = self._park(outcome, self._nails.told(reason))
        except BaseException:
            self._motions.stand_still()
            raise
        return self._ended(outcome, reason)

    def _ended(self, outcome: Outcome, reason: str) -> HammerResult:
        self._outcome = outcome
        result = self.result(outcome, reason)
        self._motions.observer.ended(result)
        return result

    def _ending(self, job: Callable[[], tuple[Outcome, str]]) -> tuple[Outcome, str]:
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

    def _job(self) -> tuple[Outcome, str]:
        self._check_calibration()
        self._motions.begin()
        return self._nails.drive(self._handover.take_tool(), lift=False)

    def _go_on(self) -> tuple[Outcome, str]:
        self._motions.check_hand()
        self._handover.clear_person("Step back. The arm looks at the hammer again, then goes on striking.")
        held = self._handover.tell_payload(self._motions.held)
        return self._nails.drive(held.forgotten(), lift=True)

    def _after_loss(self) -> str:
        """Once a person has looked, and asked for it, move the arm away from where the tool may lie."""
        prompt = (
            "The hand has lost the hammer, and the arm stands still. Find the hammer. Confirm, then hold the "
            "hold-to-run switch: the arm moves up and away slowly."
        )
        if not self._motions.person.confirm_inspection(prompt, self._config.task.handover_timeout):
            return f"nobody allowed the arm to move away: {PUT_AWAY}"
        self._handover.tool_gone()
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

    def _park(self, outcome: Outcome, reason: str) -> tuple[Outcome, str]:
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
                if not self._handover.person_clear:
                    self._handover.clear_person("Take the tool with you and step back. The arm goes home.")
                home = np.asarray(self._config.scene.home)
                held = self._motions.carried
                self._motions.rise_from_among_nails(held)
                world = self._motions.world(held)
                way = plan_transfer(self._motions.robot, self._config, world, self._motions.q, home)
                self._motions.transfer("home", way, held)
            except (PlanningError, DeviceError) as error:
                self._motions.stand_still()
                reason = f"{reason}; the arm stands where it stopped: {error}"
        return outcome, reason
