"""Drive the nail with successive strikes and measurements until an end condition holds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from toolee_robot.control.contact import ContactVerdict, Meeting
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.frames import inverse, transform
from toolee_robot.hal import Clock
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import JobEnded, Outcome, Stage, Strike
from toolee_robot.tasks.common.stages import Stages
from toolee_robot.tasks.hammering.nail_forecast import NailForecast
from toolee_robot.tasks.hammering.nail_gauge import CLEAR, NailGauge, Touches, deepest_strike
from toolee_robot.tasks.hammering.nail_stall import FEWEST, NailStall
from toolee_robot.tasks.hammering.nail_watch import NailWatch, nail_of
from toolee_robot.tasks.hammering.striking import Striking
from toolee_robot.tasks.hammering.tool_pose import Holding
from toolee_robot.types import Payload, RgbdFrame

SURELY_FLUSH = 0.5
"""Share of `flush_protrusion` up to which one measurement is enough, after a strike at a nail that was flush before it
by forecast; more needs another strike, since after slip a measurement is accurate to half a millimetre."""
SURE_IN_NOISE = 0.3
"""The same share where touches are noisy, and good for half a millimetre. Over it one more strike follows; under it
none, because a strike on a flush nail is the hardest that an arm gets."""
SOON = 2
"""Number of strikes before the next look at a nail that looked bent."""
LET_IN = "very soft wood has let it in: look at it"
"""What else may have become of a nail that is not where it should be after strikes."""
BLIND_MISSES = 3
"""Number of successive misses after which the uncorrected baseline gives up."""
WORTH = 100
"""Most further strikes that a person is told would do."""
CONFIRMED = 0.0005
"""Largest progress of a strike on a flush nail [m]."""


class NailDriving:
    """The strikes of one job.

    Args:
        motions: The arm and what it carries.
        config: Configuration of the station.
        robot: Kinematic model of arm and hand.
        clock: The station's clock.
        stages: Times the stages of the job.
        observer: Receives the events of the job.
        look: Looks at the tool from the given number of views, and whether it forgets the looks before; sets
            `motions.X_hand_ee` and returns how the tool is held.
        frames: Returns what the camera took at the last look.
        tool: Returns mass [kg] and centre of mass of the tool in the frame of its end effector [m].
        correction: Whether the estimated in-hand pose is used.

    Attributes:
        protrusion: Height of the nail's head over the wood as measured last [m]; None before `run`.
        seconds: Time that the nail has taken so far, from the first look's end on [s], station clock.
    """

    def __init__(
        self,
        motions: Motions,
        config: StationConfig,
        robot: RobotModel,
        clock: Clock,
        stages: Stages,
        observer: TaskObserver,
        look: Callable[[int, bool], Holding],
        frames: Callable[[], Sequence[RgbdFrame]],
        tool: Callable[[], Payload],
        *,
        correction: bool,
    ) -> None:
        self.protrusion: float | None = None
        self.seconds = 0.0
        self._motions, self._config, self._clock = motions, config, clock
        self._stages, self._observer = stages, observer
        self._look_from, self._frames = look, frames
        self._watch = NailWatch(config, observer)
        self._striking = Striking(motions, config, robot, clock, observer, tool)
        self._correction = correction
        self._gauge = NailGauge(motions, config, robot, observer)
        self._tool = tool
        self._forecast = NailForecast(config.work.nail_length, config.task.flush_protrusion, motions.arm.rate)
        self._strikes_seen = 0
        self._holding = Holding()
        self._measured = False
        self._taken: Touches | None = None  # of the measurement that the forecast has
        self._missed = 0  # strikes one after the other that did not meet the nail
        self._seen_too_near = 0.0  # along the face's normal, by the first touch after the first look [m]

    @property
    def strikes(self) -> tuple[Strike, ...]:
        """The strikes done so far."""
        return tuple(self._striking.done)

    @property
    def strikes_since_look(self) -> int:
        """Number of strikes since the last look at the tool."""
        return len(self.strikes) - self._strikes_seen

    @property
    def _deepest(self) -> float:
        """Depth that a strike can drive the nail at most [m]."""
        return deepest_strike(self._tool().mass, self._config.strike.speed)

    def _look_due(self, strikes: int) -> bool:
        """Whether to look again after so many strikes; not if a steadily held tool is about to finish the nail."""
        if self._watch.suspected:
            return strikes >= SOON
        usual = self._config.task.strikes_between_looks
        return strikes >= usual and not (self._holding.steady and strikes + self._forecast.left <= 1.5 * usual)

    def run(self) -> tuple[Outcome, str]:
        """Strike until the nail is flush or another end condition holds; once more after an interruption.

        The tool was looked at just before. After an interruption the nail is measured first: the interrupted strike may
        have driven it.

        Returns:
            The outcome, and the reason for a person.

        Raises:
            JobEnded: The nail was not met as expected.
            TooleeError: A motion or a plan failed.
        """
        began = self._clock.now()
        try:
            return self._run()
        finally:
            self.seconds += self._clock.now() - began

    def _run(self) -> tuple[Outcome, str]:
        task, forecast = self._config.task, self._forecast
        self._begin()
        stall = NailStall(task.min_progress)
        flush = self._missed = 0
        progress = np.inf
        doubted = home = False
        while True:
            height = forecast.height
            # Another strike confirms it: after slip a measurement is accurate only to half a millimetre.
            flush = flush + 1 if height <= task.flush_protrusion and not forecast.unmeasured else 0
            sure = forecast.finished and height <= SURELY_FLUSH * task.flush_protrusion
            done = flush > 2 or (flush and sure) or (flush == 2 and progress < CONFIRMED)
            out_of_strikes = len(self.strikes) >= task.max_strikes
            surely = not self._gauge.noisy or height <= SURE_IN_NOISE * task.flush_protrusion
            if done and (surely or home or out_of_strikes):
                return self._flush(f"the head stands {height * 1e3:.1f} mm over the wood")
            home = done
            if out_of_strikes:
                end = f"after {task.max_strikes} strikes the head stands {height * 1e3:.1f} mm over the wood"
                if 0 < forecast.left < WORTH:
                    more = math.ceil(1.2 * forecast.left)
                    end += f"; it still moves, and some {more} more would do: raise task.max_strikes"
                return Outcome.OUT_OF_STRIKES, f"{end}, not confirmed by another strike" if flush else end
            self._check_load()
            if self._look_due(self.strikes_since_look) and height > task.flush_protrusion:
                self._look(task.views_again)
            with self._stages(Stage.PLAN):
                plan = self._striking.plan(height)
            before, measured = height, None
            self._missed += 1
            with self._check_missed():
                measured = self._strike_nail(plan, before, home=home)
                self._missed = 0
            home = home and not self._missed
            if home and measured is None:
                return self._flush(f"the head stood {before * 1e3:.1f} mm over the wood before the last strike")
            if not self._missed:
                self._motions.X_hand_ee = self._holding.struck(self._motions.X_hand_ee)
            if self._missed or measured is None:
                continue
            struck, expected = forecast.unmeasured, forecast.expected
            progress, height = (
                forecast.measured(measured, self._gauge.protrusion(self._taken) if self._taken else None),
                measured,
            )
            self._taken = self._gauge.latest
            self.protrusion = height
            sank = max(progress, forecast.below)  # at least, in one strike: a mean hides one among several
            if sank > self._deepest:
                return Outcome.BENT, f"the head sank {sank * 1e3:.1f} mm in one strike: the nail has bent away"
            if self.strikes[-1].meeting is not Meeting.EXPECTED and height <= task.flush_protrusion:
                # Beside a nail that it has missed the face meets the wood at once, which reads flush.
                self._look(task.views_again)
            stall.measured(struck, progress, expected)
            if stall.strikes >= FEWEST and height <= task.flush_protrusion:
                return self._flush(f"{stall.strikes} strikes moved it no further, {height * 1e3:.1f} mm over the wood")
            if not stall.over:
                doubted = doubted and stall.suspected
                continue
            if doubted or not self._correction:
                slow = "strike.speed asks for" if plan.speed >= 0.99 * plan.wanted_speed else "arm and hand permit"
                return Outcome.STUCK, (
                    f"{stall}, and it stands {height * 1e3:.1f} mm over the wood: it has met something hard, or the "
                    f"{plan.speed:.2f} m/s that {slow} are too slow for it"
                )
            # The edge of a face that has tilted in the hand meets the wood before the nail is flush.
            doubted = True
            stall.again()
            self._look(task.views)

    def _flush(self, words: str) -> tuple[Outcome, str]:
        """The end of a nail that reads flush: not believed if no strike was felt where the nail should be."""
        if self.strikes and all(strike.meeting is not Meeting.EXPECTED for strike in self.strikes):
            return Outcome.NAIL_MISSED, f"{words}, but no strike met it where it should be: look at the nail"
        return Outcome.FLUSH, words

    def _begin(self) -> None:
        """Touch the nail: its height is known, but for an interruption, and the face's place along it is not.

        A nail that is not met is touched once more, after a look at the tool that does not believe the one before.
        """
        self._holding = Holding()
        known = self._config.work.nail_protrusion if self.protrusion is None else self._forecast.height
        self._strikes_seen = len(self.strikes)
        try:
            height = self._first_touch(known)
        except JobEnded as end:
            if not self._correction or end.outcome is not Outcome.NAIL_MISSED:
                raise
            self._observer.message(f"{end}; looking again")
            self._look(self._config.task.views, afresh=True)
            height = self._first_touch(known)
        self._forecast.measured(height)
        self._taken = self._gauge.latest
        self.protrusion = height
        # Not before: where the nail is not, or not as high as the file has it, something else looks like a nail.
        others = [nail_of(body) for body in self._motions.in_the_way]
        self._watch.look(self._frames(), height, self._forecast.sigma, others)

    def _first_touch(self, known: float) -> float:
        """Touch a nail that protrudes by `known` [m], but for an interruption; returns what it protrudes by [m]."""
        with self._stages(Stage.PLAN):
            plan = self._striking.plan_touch(known)
        with self._stages(Stage.TOUCH), self._check_blind():
            if self._measured:
                return self._gauge.resume(plan, known)
            seen = self._motions.X_hand_ee
            self._gauge.begin(plan)
            self._seen_too_near = float((inverse(seen) @ self._motions.X_hand_ee)[2, 3])
            self._measured = True
        return known

    def _look(self, views: int, *, afresh: bool = False) -> None:
        if self._correction:
            self._holding = self._look_from(views, afresh)
            # The camera's and the arm's errors are those of the look before, which the touch has told along the normal.
            self._motions.X_hand_ee = self._motions.X_hand_ee @ transform(p=[0.0, 0.0, self._seen_too_near])
            self._watch.look(self._frames(), self._forecast.height, self._forecast.sigma)
        self._strikes_seen = len(self.strikes)

    def _strike_nail(self, plan: StrikePlan, before: float, *, home: bool = False) -> float | None:
        """Strike a nail that protrudes by `before` [m], as far as is known.

        The strike is recorded in every case.

        Args:
            plan: The strike.
            before: Protrusion before it [m].
            home: Whether it is the last one, of a nail that was measured to be flush.

        Returns:
            The protrusion measured after it [m]; None where the forecast is good enough.

        Raises:
            JobEnded: The strike, or the touch after it, does not meet the nail.
        """
        with self._stages(Stage.STRIKE):
            report, verdict = self._striking.swing(plan)
            met = verdict.meeting is Meeting.EXPECTED
            load = self._striking.load(report)
            last = len(self.strikes) + 1 >= self._config.task.max_strikes or bool(load.excess(self._config.strike))
            unsure = self._forecast.struck(verdict, plan.speed) if met else True
            measure = not home and (unsure or last or self._watch.suspected) if met else True
            if verdict.meeting in (Meeting.LATE, Meeting.NONE):
                self._forecast.unfelt(f"{verdict}: measuring whether the nail was hit")
            look_due = self._look_due(self.strikes_since_look + 1)
            self._striking.retract(plan, CLEAR if measure or look_due else min(plan.run_up, self._config.strike.run_up))
        height = None
        try:
            if verdict.meeting is Meeting.EARLY:
                raise JobEnded(Outcome.NAIL_MISSED, f"{verdict}: the nail is not where the face went")
            if not measure:
                return None
            height = self._touch_after(plan, before, verdict)
            return height
        finally:
            self._striking.record(plan, report, verdict, load, height)

    def _touch_after(self, plan: StrikePlan, before: float, verdict: ContactVerdict) -> float:
        """Touch the nail after a strike; returns what it protrudes by [m]. See `_strike_nail`."""
        met = verdict.meeting is Meeting.EXPECTED
        if self._forecast.surprise:
            self._observer.message(self._forecast.surprise)
        try:
            with self._stages(Stage.TOUCH):
                if self._striking.leans:
                    self._gauge.go_over(self._striking.plan_touch(before))
                elif self._config.strike.deepest is not None:  # after a swing the face is no longer square to the nail
                    self._gauge.go_over(plan)
                # With a corrected face pose, a head that is no longer there after a strike means a bent nail.
                missed = Outcome.BENT if met and self._correction else Outcome.NAIL_MISSED
                height = self._gauge.measure(before, self._forecast.unknown, missed)
        except JobEnded as end:
            if end.outcome is Outcome.BENT:
                gone = f"the strike met the nail, which has bent away since, or {LET_IN} ({end})"
                raise JobEnded(Outcome.BENT, gone) from end
            if met:
                raise
            raise JobEnded(end.outcome, f"{verdict}: the nail is not where the face went ({end})") from end
        # Those that missed before this one have driven nothing: two misses would permit what neither alone does.
        may_have_driven = self._forecast.unknown - (self._missed - 1)
        if not met and before - height > may_have_driven * self._deepest:
            raise JobEnded(Outcome.NAIL_MISSED, f"{verdict}: the nail is not where the face went, or {LET_IN}")
        return height

    def _check_load(self) -> None:
        """Allow no further strike after one that brought the arm too near to a stop of its own."""
        if self.strikes and (excess := self.strikes[-1].load.excess(self._config.strike)):
            raise JobEnded(Outcome.OVERLOAD, excess)

    @contextmanager
    def _check_missed(self) -> Iterator[None]:
        """Look again after the first strike that misses the nail; the second successive one ends the job."""
        with self._check_blind(self._missed):
            try:
                yield
            except JobEnded as end:
                if not self._correction or self._missed > 1 or end.outcome is not Outcome.NAIL_MISSED:
                    raise
                self._observer.message(f"{end}; looking again")
                self._look(self._config.task.views)

    @contextmanager
    def _check_blind(self, missed: int = 0) -> Iterator[None]:
        """Let the uncorrected baseline continue after a miss, up to BLIND_MISSES successive ones.

        The baseline exists to show the effect of striking without correction.
        """
        try:
            yield
        except JobEnded as end:
            if self._correction or missed >= BLIND_MISSES or end.outcome is not Outcome.NAIL_MISSED:
                raise
            self._observer.message(f"{end}; without correction it strikes on")
