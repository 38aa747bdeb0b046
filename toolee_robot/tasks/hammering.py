"""The hammering job: take the tool, look at it, strike until the nail is flush, put the arm safely away.

A state machine over the hardware abstraction alone. What it knows of the world is its station file, what the camera
shows and what the arm and the hand feel. Every ending is an `Outcome` with a reason; every exception leaves the arm
at a standstill.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from toolee_robot.config import StationConfig
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.control.slip import merge, slip
from toolee_robot.control.strike import plan_strike
from toolee_robot.control.transfer import plan_transfer
from toolee_robot.control.views import plan_handover, plan_views
from toolee_robot.errors import DeviceError, GripError, PerceptionError, PlanningError, UnreachableError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard, MotionReport, Station
from toolee_robot.tasks.look import Look, Perceiver
from toolee_robot.tasks.motions import UP, Motions
from toolee_robot.tasks.observer import TaskObserver
from toolee_robot.tasks.outcome import Blow, Ended, HammerResult, Outcome, Stage
from toolee_robot.tasks.stages import Stages
from toolee_robot.tasks.touch import CLEAR, TOLERANCE, NailGauge
from toolee_robot.types import InHandEstimate

SETTLE = 0.3
"""[s] of standing still before a frame, so that arm, wrist and tool have stopped swinging."""
MAX_BLOW = 0.008
"""[m] No blow of this arm drives a nail further: a head that sinks more has bent away."""
FLUSH_WHEN_STALLED = 0.0015
"""[m] Where a nail that no longer yields is called flush: a measurement is good to half a millimetre after slip."""
BLIND_MISSES = 3
"""Blows in a row without meeting the nail after which the uncorrected baseline gives up."""
CONFIRMED = 0.0005
"""[m] A blow on a flush nail moves it no further than this."""


@dataclass(frozen=True)
class Grasp:
    """How the tool would lie in the hand in a perfect handover, from the tool's data sheet.

    X_hand_tool, X_tool_ee: 4x4. mass [kg]. p_tool_com: centre of mass (3,) [m], tool frame.
    """

    X_hand_tool: Array
    X_tool_ee: Array
    mass: float
    p_tool_com: Array

    @property
    def X_hand_ee(self) -> Array:
        return self.X_hand_tool @ self.X_tool_ee


class HammeringTask:
    """One job. `correction=False` strikes with the nominal in-hand pose: the paper's baseline, for comparison only."""

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
        self._robot = RobotModel.load(config.arm.model, config.arm.calibration)
        self._motions = Motions(station, config, self._robot, self._observer, grasp.X_hand_ee)
        self._gauge = NailGauge(self._motions, config, self._robot, self._observer)
        self._stages = Stages(self._observer)
        self._person_clear = True
        self._blows: list[Blow] = []
        self._estimates: list[tuple[float, InHandEstimate]] = []
        self._blows_seen = 0
        self._protrusion: float | None = None

    def run(self) -> HammerResult:
        """Do the job and park. Returns how it ended; only a programming error or KeyboardInterrupt escapes, after
        arm and hand have been stopped, the grip kept."""
        try:
            outcome, reason = self._job()
            outcome, reason = self._park(outcome, reason)
        except BaseException:
            self._motions.stand_still()
            raise
        result = self.result(outcome, reason)
        self._observer.ended(result)
        return result

    def result(self, outcome: Outcome, reason: str) -> HammerResult:
        """The record of the job as far as it went: what is left to say after an interruption."""
        return HammerResult(
            outcome, reason, tuple(self._blows), self._protrusion, tuple(self._estimates), dict(self._stages.seconds)
        )

    def _job(self) -> tuple[Outcome, str]:
        try:
            self._motions.begin()
            self._take_tool()
            self._look(self._config.task.views)
            return self._drive()
        except Ended as end:
            return end.outcome, str(end)
        except PerceptionError as error:
            return Outcome.POSE_UNKNOWN, str(error)
        except PlanningError as error:
            return Outcome.NO_PLAN, str(error)
        except GripError as error:
            return Outcome.TOOL_LOST, str(error)
        except DeviceError as error:
            self._motions.stand_still()
            return Outcome.DEVICE_FAULT, str(error)

    # -- stages ----------------------------------------------------------------------------------------------------

    def _take_tool(self) -> None:
        station = self._station
        with self._stages(Stage.HANDOVER):
            self._check_reach()
            station.hand.open()
            q_hand = self._motions.q_hand
            world = CollisionWorld(self._robot, self._config, q_hand)
            self._motions.execute(
                "to the handover", plan_handover(self._robot, self._config, world, self._motions.q, q_hand)
            )
            self._person_clear = False
            if not station.person.request_handover(
                "Put the hammer's handle into the open hand, face towards the fingertips.",
                self._config.task.handover_timeout,
            ):
                raise Ended(Outcome.NO_HANDOVER, "nobody handed a tool over in time: run the job again")
        with self._stages(Stage.GRIP):
            station.hand.close()
            if not station.hand.state().holding:
                raise Ended(Outcome.NO_GRIP, "the hand closed but holds nothing: hand the tool over again")
            if not station.person.release("Let go and step back.", self._config.task.handover_timeout):
                raise Ended(Outcome.PERSON_NEAR, "nobody confirmed to be out of reach: no motion")
            self._person_clear = True
            if not station.hand.state().holding:
                raise Ended(Outcome.NO_GRIP, "the tool left the hand as it was let go: hand it over again")
            self._motions.held = True
            grasp = self._grasp
            q_hand = self._motions.q_hand
            station.arm.set_payload(self._robot.payload(q_hand, grasp.X_hand_tool, grasp.mass, grasp.p_tool_com))

    def _check_reach(self) -> None:
        """Refuse a nail that is out of reach before anyone is asked for a tool. Only that: whether a reachable nail
        can be hit without a collision depends on how the tool will lie in the hand."""
        q_hand = self._robot.description.hand_closed
        world = CollisionWorld(self._robot, self._config, q_hand, self._motions.X_hand_ee)
        X_base_nail = self._config.work.X_base_nail()
        try:
            plan_strike(self._robot, self._config, world, self._motions.q, q_hand, self._motions.X_hand_ee, X_base_nail)
        except UnreachableError:
            raise
        except PlanningError as error:
            self._observer.message(f"with the tool as it nominally lies in the hand no blow is possible: {error}")

    def _look(self, views: int) -> None:
        """Set the believed pose of the face in the hand from what the camera sees; as many other views if in doubt."""
        if not self._correction:
            return
        look = Look(self._station, self._config, self._robot, self._perceiver, self._observer, self._grasp.X_hand_ee)
        for attempt in (1, 2):
            with self._stages(Stage.VIEW):
                q_hand = self._motions.q_hand
                # Another seed, other views: the same ones would show the same again.
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
                    self._motions.execute("to a view", view.transfer)
                    self._station.clock.sleep(SETTLE)
                with self._stages(Stage.PERCEIVE):
                    look.take()
            try:
                with self._stages(Stage.PERCEIVE):
                    estimate = look.fuse()
                break
            except PerceptionError as error:
                if attempt == 2:
                    raise
                self._observer.message(f"{error}; looking again")
        if self._estimates:
            estimate = self._after_slip(self._estimates[-1][1], estimate)
        self._believe(estimate)
        self._blows_seen = len(self._blows)

    def _believe(self, estimate: InHandEstimate) -> None:
        self._estimates.append((self._station.clock.now(), estimate))
        self._motions.X_hand_ee = estimate.X_hand_ee

    def _after_slip(self, before: InHandEstimate, now: InHandEstimate) -> InHandEstimate:
        """What the looks so far say together. Ends the job when the tool has slipped too far to go on."""
        task = self._config.task
        distance, angle = slip(before, now)
        self._observer.message(f"slip in the hand {distance * 1e3:.1f} mm, {np.rad2deg(angle):.1f} deg")
        if distance > task.abort_slip or angle > task.abort_slip_angle:
            self._believe(now)
            raise Ended(
                Outcome.TOOL_SLIPPED,
                f"the tool slipped {distance * 1e3:.0f} mm and {np.rad2deg(angle):.0f} deg in the hand: grip it again",
            )
        blows = max(len(self._blows) - self._blows_seen, 1)
        return merge(before, now, blows * task.slip_per_blow, blows * task.slip_angle_per_blow)

    def _drive(self) -> tuple[Outcome, str]:
        """Blow after blow, each measured, until there is a reason to stop."""
        config, task = self._config, self._config.task
        self._protrusion = config.work.nail_protrusion
        plan = self._plan(self._protrusion)
        with self._stages(Stage.TOUCH), self._unless_blind():
            self._gauge.begin(plan)
        stalled = flush = missed = 0
        progress = np.inf
        doubted = False
        while True:
            # Another blow confirms it: after slip a measurement is good to half a millimetre only.
            flush = flush + 1 if self._protrusion <= task.flush_protrusion else 0
            if flush > 2 or (flush == 2 and progress < CONFIRMED):
                return Outcome.FLUSH, f"the head stands {self._protrusion * 1e3:.1f} mm over the wood"
            if len(self._blows) >= task.max_blows:
                end = f"after {task.max_blows} blows the head stands {self._protrusion * 1e3:.1f} mm over the wood"
                return Outcome.OUT_OF_BLOWS, f"{end}, not confirmed by another blow" if flush else end
            if len(self._blows) - self._blows_seen >= task.blows_between_looks and not flush:
                self._look(task.views_again)
            plan = self._plan(self._protrusion)
            before = self._protrusion
            missed += 1
            with self._unless_blind(missed):
                report = self._strike(plan)
                with self._stages(Stage.TOUCH):
                    # A head that a blow has moved out of the face's way has bent, if the face is where it seems.
                    gone = Outcome.BENT if self._correction else Outcome.NAIL_MISSED
                    self._protrusion = self._gauge.measure(before, missed=gone)
                self._record_blow(plan, report)
                missed = 0
            if missed:
                continue
            progress = before - self._protrusion
            if progress > MAX_BLOW:
                return Outcome.BENT, f"the head sank {progress * 1e3:.1f} mm in one blow: the nail has bent away"
            stalled = stalled + 1 if progress < task.min_progress else 0
            if stalled < 2:
                continue
            if self._protrusion <= FLUSH_WHEN_STALLED:
                return Outcome.FLUSH, f"two blows moved it no further, {self._protrusion * 1e3:.1f} mm over the wood"
            if doubted or not self._correction:
                return Outcome.STUCK, f"two blows moved the head under {task.min_progress * 1e3:.1f} mm"
            # A face that has tilted in the hand meets the wood with its edge before the nail is home.
            doubted, stalled = True, 0
            self._look(task.views)

    @contextmanager
    def _unless_blind(self, missed: int = 0) -> Iterator[None]:
        """The uncorrected baseline goes on where the job would end because face and nail do not meet as believed: it is
        there to show what striking blindly does, up to BLIND_MISSES blows in a row."""
        try:
            yield
        except Ended as end:
            if self._correction or missed >= BLIND_MISSES or end.outcome is not Outcome.NAIL_MISSED:
                raise
            self._observer.message(f"{end}; without correction it strikes on")

    # -- steps -----------------------------------------------------------------------------------------------------

    def _plan(self, height: float) -> StrikePlan:
        """A blow at the nail as it stands out by `height` [m]."""
        with self._stages(Stage.PLAN):
            q_hand = self._motions.q_hand
            X_base_nail = self._config.work.X_base_nail(height)
            plan = plan_strike(
                self._robot,
                self._config,
                self._motions.world(),
                self._motions.q,
                q_hand,
                self._motions.X_hand_ee,
                X_base_nail,
            )
            self._observer.planned(self._station.clock.now(), plan)
            return plan

    def _strike(self, plan: StrikePlan) -> MotionReport:
        """Swing. A blow that meets nothing, or meets something too early, ends the job."""
        with self._stages(Stage.STRIKE):
            self._motions.execute("to the run-up", plan.approach)
            guard = ContactGuard(self._config.strike.contact_force, after=0.5 * plan.contact_time)
            started = self._station.clock.now()
            report = self._motions.execute("strike", plan.strike, guard)
            below = self._robot.arm.fk(plan.q_contact)[2, 3] - self._robot.arm.fk(self._motions.q)[2, 3]
            # Stopped above the nail by something else: up from there, never down to it.
            self._motions.straight("up", UP, CLEAR + max(float(below), 0.0))
            if report.contact is None:
                raise Ended(Outcome.NAIL_MISSED, "the blow met nothing: the nail is not where the face went")
            early = plan.contact_time - (report.contact.stamp - started)
            if early * plan.speed > 2 * TOLERANCE:
                raise Ended(
                    Outcome.NAIL_MISSED, f"the tool hit something {early * plan.speed * 1e3:.0f} mm before the nail"
                )
            return report

    def _record_blow(self, plan: StrikePlan, report: MotionReport) -> None:
        assert report.contact is not None
        assert self._protrusion is not None
        force = float(np.max(np.linalg.norm(report.wrenches[:, :3], axis=1)))
        self._observer.contact(report.contact.stamp, force, plan.X_base_ee_contact)
        blow = Blow(len(self._blows) + 1, report.contact.stamp, plan.speed, force, self._protrusion)
        self._blows.append(blow)
        self._observer.blow(blow)

    def _park(self, outcome: Outcome, reason: str) -> tuple[Outcome, str]:
        """Bring the arm home with the tool still in the hand. It stays where it stands when a device has failed, a tool
        has dropped who knows where, a person may be within reach, or no safe way is known."""
        if outcome in (Outcome.DEVICE_FAULT, Outcome.TOOL_LOST, Outcome.PERSON_NEAR):
            return outcome, f"{reason}; the arm stands still, put it away by hand"
        with self._stages(Stage.PARK):
            try:
                if not self._person_clear:
                    prompt = "Take the tool along and step back: the arm goes home."
                    if not self._station.person.release(prompt, self._config.task.handover_timeout):
                        return outcome, f"{reason}; the arm stays: nobody confirmed to be out of its reach"
                home = np.asarray(self._config.scene.home)
                self._motions.execute(
                    "home", plan_transfer(self._robot, self._config, self._motions.world(), self._motions.q, home)
                )
            except (PlanningError, DeviceError) as error:
                self._motions.stand_still()
                reason = f"{reason}; the arm stands where it stopped: {error}"
        return outcome, reason
