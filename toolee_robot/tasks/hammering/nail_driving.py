"""Drive the nail: strike after strike, each measured, until there is a reason to stop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from toolee_robot.config import StationConfig
from toolee_robot.control.contact import ContactVerdict, Meeting
from toolee_robot.control.planning.strike import plan_strike
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.hal import Clock, MotionReport
from toolee_robot.tasks.common.motions import UP, Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import JobEnded, Outcome, Stage, Strike
from toolee_robot.tasks.common.stages import Stages
from toolee_robot.tasks.hammering.nail_gauge import CLEAR, MAX_DEPTH_PER_STRIKE, NailGauge

FLUSH_WHEN_STALLED = 0.0015
"""[m] Where a nail that no longer yields is called flush: a measurement is good to half a millimetre after slip."""
BLIND_MISSES = 3
"""Strikes in a row without meeting the nail after which the uncorrected baseline gives up."""
CONFIRMED = 0.0005
"""[m] A strike on a flush nail moves it no further than this."""


class NailDriving:
    """The strikes of one job. strikes: those done; protrusion: of the nail as measured last [m], None before.

    look: looks at the tool from so many views and sets `motions.X_hand_ee`. correction: whether that is relied on.
    """

    def __init__(
        self,
        motions: Motions,
        config: StationConfig,
        robot: RobotModel,
        clock: Clock,
        stages: Stages,
        observer: TaskObserver,
        look: Callable[[int], None],
        *,
        correction: bool,
    ) -> None:
        self.strikes: list[Strike] = []
        self.protrusion: float | None = None
        self._motions, self._config, self._robot, self._clock = motions, config, robot, clock
        self._stages, self._observer = stages, observer
        self._look_from = look
        self._correction = correction
        self._gauge = NailGauge(motions, config, robot, observer)
        self._strikes_seen = 0

    @property
    def strikes_since_look(self) -> int:
        """Strikes since the tool was last looked at."""
        return len(self.strikes) - self._strikes_seen

    def run(self) -> tuple[Outcome, str]:
        """Strike until the nail is flush or there is a reason to give up. Raises what the motions raise, and Ended."""
        config, task = self._config, self._config.task
        height = self.protrusion = config.work.nail_protrusion
        plan = self._plan(height)
        with self._stages(Stage.TOUCH), self._check_blind():
            self._gauge.begin(plan)
        stalled = flush = missed = 0
        progress = np.inf
        doubted = False
        while True:
            # Another strike confirms it: after slip a measurement is good to half a millimetre only.
            flush = flush + 1 if height <= task.flush_protrusion else 0
            if flush > 2 or (flush == 2 and progress < CONFIRMED):
                return Outcome.FLUSH, f"the head stands {height * 1e3:.1f} mm over the wood"
            if len(self.strikes) >= task.max_strikes:
                end = f"after {task.max_strikes} strikes the head stands {height * 1e3:.1f} mm over the wood"
                return Outcome.OUT_OF_STRIKES, f"{end}, not confirmed by another strike" if flush else end
            if self.strikes_since_look >= task.strikes_between_looks and not flush:
                self._look(task.views_again)
            plan = self._plan(height)
            before = height
            missed += 1
            with self._check_missed(missed):
                height = self.protrusion = self._strike_nail(plan, before)
                missed = 0
            if missed:
                continue
            progress = before - height
            if progress > MAX_DEPTH_PER_STRIKE:
                return Outcome.BENT, f"the head sank {progress * 1e3:.1f} mm in one strike: the nail has bent away"
            stalled = stalled + 1 if progress < task.min_progress else 0
            if stalled < 2:
                continue
            if height <= FLUSH_WHEN_STALLED:
                return Outcome.FLUSH, f"two strikes moved it no further, {height * 1e3:.1f} mm over the wood"
            if doubted or not self._correction:
                return Outcome.STUCK, f"two strikes moved the head under {task.min_progress * 1e3:.1f} mm"
            # A face that has tilted in the hand meets the wood with its edge before the nail is home.
            doubted, stalled = True, 0
            self._look(task.views)

    def _look(self, views: int) -> None:
        self._look_from(views)
        self._strikes_seen = len(self.strikes)

    def _plan(self, height: float) -> StrikePlan:
        """A strike at the nail as it stands out by `height` [m]."""
        with self._stages(Stage.PLAN):
            motions = self._motions
            plan = plan_strike(
                self._robot,
                self._config,
                motions.world(),
                motions.q,
                motions.q_hand,
                motions.X_hand_ee,
                self._config.work.X_base_nail(height),
            )
            self._observer.planned(self._clock.now(), plan)
            return plan

    def _strike_nail(self, plan: StrikePlan, before: float) -> float:
        """Strike a nail that stands out by `before` [m] and measure how far it stands out now [m]. Raises Ended when
        the strike or the touch after it does not meet the nail; it is a strike all the same."""
        with self._stages(Stage.STRIKE):
            report, verdict = self._swing(plan)
        height = None
        try:
            if verdict.meeting is not Meeting.EXPECTED:
                raise JobEnded(Outcome.NAIL_MISSED, f"{verdict}: the nail is not where the face went")
            with self._stages(Stage.TOUCH):
                # A head that a strike has moved out of the face's way has bent, if the face is where it seems.
                gone = Outcome.BENT if self._correction else Outcome.NAIL_MISSED
                height = self._gauge.measure(before, missed=gone)
            return height
        finally:
            self._record(plan, report, verdict, height)

    def _swing(self, plan: StrikePlan) -> tuple[MotionReport, ContactVerdict]:
        """The strike, and straight up again from wherever it ended."""
        motions = self._motions
        motions.transfer("to the run-up", plan.approach)
        motions.arm.permit_swings(self._config.task.handover_timeout)
        report, verdict = motions.swing("strike", plan)
        below = self._robot.arm.fk(plan.q_contact)[2, 3] - self._robot.arm.fk(motions.q)[2, 3]
        # Stopped above the nail by something else: up from there, never down to it.
        motions.straight("up", UP, CLEAR + max(float(below), 0.0))
        return report, verdict

    def _record(self, plan: StrikePlan, report: MotionReport, verdict: ContactVerdict, height: float | None) -> None:
        force = float(np.max(np.linalg.norm(report.wrenches[:, :3], axis=1)))
        stamp = report.stamps[-1] if report.contact is None else report.contact.stamp
        if report.contact is not None:
            self._observer.contact(stamp, force, plan.X_base_ee_contact)
        strike = Strike(len(self.strikes) + 1, float(stamp), plan.speed, force, verdict.meeting, height)
        self.strikes.append(strike)
        self._observer.strike(strike)

    @contextmanager
    def _check_missed(self, missed: int) -> Iterator[None]:
        """The first strike that does not meet the nail is a reason to look again; the next one ends the job."""
        with self._check_blind(missed):
            try:
                yield
            except JobEnded as end:
                if not self._correction or missed > 1 or end.outcome is not Outcome.NAIL_MISSED:
                    raise
                self._observer.message(f"{end}; looking again")
                self._look(self._config.task.views)

    @contextmanager
    def _check_blind(self, missed: int = 0) -> Iterator[None]:
        """The uncorrected baseline goes on where the job would end because face and nail do not meet as believed: it is
        there to show what striking blindly does, up to BLIND_MISSES strikes in a row."""
        try:
            yield
        except JobEnded as end:
            if self._correction or missed >= BLIND_MISSES or end.outcome is not Outcome.NAIL_MISSED:
                raise
            self._observer.message(f"{end}; without correction it strikes on")
