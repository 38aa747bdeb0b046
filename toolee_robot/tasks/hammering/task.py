"""The hammering job: take the tool, look at it, strike until the nail is flush, park the arm.

A state machine over the hardware abstraction. Its inputs are the station file, the camera's frames and the sensors of
arm and hand. Every job ends with an `Outcome` and a reason; every exception leaves the arm at a standstill.
"""

from __future__ import annotations

from datetime import date

import numpy as np

from toolee_robot.config import StationConfig
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.modes import Mode
from toolee_robot.control.planning.strike import plan_strike
from toolee_robot.control.planning.transfer import plan_transfer
from toolee_robot.control.planning.views import plan_handover, plan_views
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.control.slip import merge, slip
from toolee_robot.errors import (
    DeviceError,
    GripError,
    PerceptionError,
    PersonNearError,
    PlanningError,
    UnreachableError,
)
from toolee_robot.hal import Station
from toolee_robot.tasks.common.look import Look, Perceiver
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import HammerResult, JobEnded, Outcome, Stage
from toolee_robot.tasks.common.stages import Stages
from toolee_robot.tasks.hammering.grasp import Grasp
from toolee_robot.tasks.hammering.nail_driving import NailDriving
from toolee_robot.types import InHandEstimate

SETTLE = 0.3
"""Time at standstill before a frame is taken, so that arm, wrist and tool have stopped swinging [s]."""


class HammeringTask:
    """One hammering job, from the handover to the parked arm.

    Args:
        station: The devices of the station.
        perceiver: Estimates the tool's pose from frames; usually a `ToolPerception`.
        config: Configuration of the station.
        grasp: Nominal grasp of the tool that will be handed over.
        correction: Whether the estimated in-hand pose is used. False strikes with the nominal one, which is the paper's
            baseline, for comparison only.
        observer: Receives the events of the job; None for no observer.
    """

    def __init__(
        self,
        station: Station,
        perceiver: Perceiver,
        config: StationConfig,
        grasp: Grasp,
        *,
        correction: bool = True,
        observer: TaskObserver | None = None,
    ) -> None:
        self._station = station
        self._perceiver = perceiver
        self._config = config
        self._grasp = grasp
        self._correction = correction
        self._observer = observer or TaskObserver()
        self._robot = RobotModel.of_station(config)
        self._motions = Motions(station, config, self._robot, self._observer, grasp.X_hand_ee)
        self._stages = Stages(self._observer)
        self._nail_driving = NailDriving(
            self._motions,
            config,
            self._robot,
            station.clock,
            self._stages,
            self._observer,
            self._look,
            correction=correction,
        )
        self._person_clear = True
        self._estimates: list[tuple[float, InHandEstimate]] = []

    def run(self) -> HammerResult:
        """Do the job and park the arm.

        Only programming errors and KeyboardInterrupt propagate, after arm and hand have stopped with the grip kept.

        Returns:
            The result of the job.
        """
        try:
            outcome, reason = self._job()
            outcome, reason = self._park(outcome, reason)
        except BaseException:
            self._motions.stand_still()
            raise
        result = self.result(outcome, reason)
        self._observer.ended(result)
        return result

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
            tuple(self._nail_driving.strikes),
            self._nail_driving.protrusion,
            tuple(self._estimates),
            dict(self._stages.seconds),
        )

    def _job(self) -> tuple[Outcome, str]:
        try:
            self._check_calibration()
            self._motions.begin()
            self._take_tool()
            self._look(self._config.task.views)
            return self._nail_driving.run()
        except JobEnded as end:
            return end.outcome, str(end)
        except PersonNearError as error:
            self._motions.stand_still()
            return Outcome.PERSON_NEAR, str(error)
        except PerceptionError as error:
            return Outcome.POSE_UNKNOWN, str(error)
        except PlanningError as error:
            return Outcome.NO_PLAN, str(error)
        except GripError as error:
            self._motions.retreat()
            return Outcome.TOOL_LOST, str(error)
        except DeviceError as error:
            self._motions.stand_still()
            return Outcome.DEVICE_FAULT, str(error)

    def _check_calibration(self) -> None:
        """Refuse a station whose camera calibration is missing or invalid."""
        calibration = self._config.calibration
        if calibration is None:
            raise JobEnded(Outcome.NOT_READY, "the station is not calibrated: calibrate it, enter the result")
        station = self._station
        problems = calibration.problems(station.robot_serial, station.camera_serial, date.today())
        if problems:
            raise JobEnded(Outcome.NOT_READY, "the calibration is not valid: " + "; ".join(problems))

    def _take_tool(self) -> None:
        station, timeout = self._station, self._config.task.handover_timeout
        with self._stages(Stage.HANDOVER):
            self._check_reach()
            self._empty_hand()
            q_hand = self._motions.q_hand
            world = CollisionWorld(self._robot, self._config, q_hand)
            self._motions.transfer(
                "to the handover", plan_handover(self._robot, self._config, world, self._motions.q, q_hand)
            )
            self._person_clear = False
            if not station.person.request_handover(
                "Put the hammer's handle into the open hand, face towards the fingertips.", timeout
            ):
                raise JobEnded(Outcome.NO_HANDOVER, "nobody handed a tool over in time: run the job again")
        with self._stages(Stage.GRIP):
            station.hand.close()
            if not station.hand.state().holding:
                raise JobEnded(Outcome.NO_GRIP, "the hand closed but holds nothing: hand the tool over again")
            self._clear_person("Let go and step back.")
            if not station.hand.state().holding:
                raise JobEnded(Outcome.NO_GRIP, "the tool left the hand as it was let go: hand it over again")
            self._motions.held = True
            grasp = self._grasp
            q_hand = self._motions.q_hand
            self._motions.arm.set_payload(self._robot.payload(q_hand, grasp.X_hand_tool, grasp.mass, grasp.p_tool_com))

    def _empty_hand(self) -> None:
        """Open the hand; a person takes a tool that it still holds first, so that it does not fall."""
        station = self._station
        if station.hand.state().holding:
            self._person_clear = False
            prompt = "The hand still holds a tool: take hold of it, the hand opens."
            if not station.person.take_tool(prompt, self._config.task.handover_timeout):
                raise JobEnded(Outcome.NOT_READY, "the hand still holds a tool, and nobody took it: take it out first")
        station.hand.open()

    def _clear_person(self, prompt: str) -> None:
        """Ask the person to step back, and allow fast motion once they confirm it.

        Raises:
            PersonNearError: They did not confirm it.
        """
        if not self._station.person.release(prompt, self._config.task.handover_timeout):
            raise PersonNearError("nobody confirmed to be out of reach: no motion", code="person_near.not_released")
        self._motions.arm.mode = Mode.UNATTENDED
        self._person_clear = True

    def _check_reach(self) -> None:
        """Refuse a nail that is out of reach before a tool is requested.

        Other failures are only reported: a collision depends on the tool's true pose in the hand.
        """
        q_hand = self._robot.description.hand_closed
        world = CollisionWorld(self._robot, self._config, q_hand, self._motions.X_hand_ee)
        X_base_nail = self._config.work.X_base_nail()
        try:
            plan_strike(self._robot, self._config, world, self._motions.q, q_hand, self._motions.X_hand_ee, X_base_nail)
        except UnreachableError:
            raise
        except PlanningError as error:
            self._observer.message(f"with the tool as it nominally lies in the hand no strike is possible: {error}")

    def _look(self, views: int) -> None:
        """Estimate the pose of the face in the hand from `views` views; on failure once more from other views."""
        if not self._correction:
            return
        look = Look(self._station, self._config, self._robot, self._perceiver, self._observer, self._grasp.X_hand_ee)
        for attempt in (1, 2):
            with self._stages(Stage.VIEW):
                q_hand = self._motions.q_hand
                # Another seed gives other views; the same views would give the same result.
                plan = plan_views(
                    self._robot,
                    self._config,
                    self._motions.world(),
                    self._motions.q,
                    q_hand,
                    self._grasp.X_hand_ee,
                    count=views,
                    seed=attempt - 1,
                )
            for view in plan.views:
                with self._stages(Stage.VIEW):
                    self._motions.transfer("to a view", view.transfer)
                    self._station.clock.sleep(SETTLE)
                with self._stages(Stage.PERCEIVE):
                    look.take()
            try:
                with self._stages(Stage.PERCEIVE):
                    estimate = look.fuse()
                    if self._estimates:
                        estimate = self._after_slip(self._estimates[-1][1], estimate)
                break
            except (PerceptionError, JobEnded) as error:
                # Not usable, or slipped too far: look once more, from other views.
                if attempt == 2:
                    raise
                self._observer.message(f"{error}; looking again")
        self._estimates.append((self._station.clock.now(), estimate))
        self._motions.X_hand_ee = estimate.X_hand_ee

    def _after_slip(self, before: InHandEstimate, now: InHandEstimate) -> InHandEstimate:
        """Fuse the estimates of two looks; ends the job when the tool has slipped too far."""
        task = self._config.task
        distance, angle = slip(before, now)
        self._observer.message(f"slip in the hand {distance * 1e3:.1f} mm, {np.rad2deg(angle):.1f}°")
        if distance > task.abort_slip or angle > task.abort_slip_angle:
            raise JobEnded(
                Outcome.TOOL_SLIPPED,
                f"the tool slipped {distance * 1e3:.0f} mm and {np.rad2deg(angle):.0f}° in the hand: grip it again",
            )
        strikes = max(self._nail_driving.strikes_since_look, 1)
        return merge(before, now, strikes * task.slip_per_strike, strikes * task.slip_angle_per_strike)

    def _park(self, outcome: Outcome, reason: str) -> tuple[Outcome, str]:
        """Bring the arm home with the tool still in the hand.

        The arm stays in place when a device has failed, the tool was dropped at an unknown place, a person may be
        within reach, or no safe motion was found.
        """
        if outcome is Outcome.NOT_READY:
            return outcome, f"{reason}; nothing was moved"
        if outcome in (Outcome.DEVICE_FAULT, Outcome.TOOL_LOST, Outcome.PERSON_NEAR):
            return outcome, f"{reason}; the arm stands still, put it away by hand"
        with self._stages(Stage.PARK):
            try:
                if not self._person_clear:
                    self._clear_person("Take the tool along and step back: the arm goes home.")
                home = np.asarray(self._config.scene.home)
                world = self._motions.world()
                self._motions.transfer("home", plan_transfer(self._robot, self._config, world, self._motions.q, home))
            except (PlanningError, DeviceError) as error:
                self._motions.stand_still()
                reason = f"{reason}; the arm stands where it stopped: {error}"
        return outcome, reason
