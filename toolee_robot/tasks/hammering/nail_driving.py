"""Drive the nail with successive strikes and measurements until an end condition holds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.control.contact import ContactVerdict, Meeting
from toolee_robot.control.records import StrikePlan
from toolee_robot.frames import inverse
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.look import Look
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.outcome import JobEnded, Outcome, Stage, Strike
from toolee_robot.tasks.hammering.nail_forecast import FEWEST, NailForecast, NailStall
from toolee_robot.tasks.hammering.nail_gauge import NailGauge, Touches, deepest_strike
from toolee_robot.tasks.hammering.nail_watch import NailWatch, nail_of
from toolee_robot.tasks.hammering.striking import Striking

SURE_SHARE = 0.5
"""Share of `flush_protrusion` up to which one measurement is enough, after a strike at a nail that was flush before it
by forecast; more needs another strike, since after slip a measurement is accurate to half a millimetre."""
SURE_SHARE_OF_TWO = 0.8
"""The same share for two measurements, between which the strikes moved the nail by less than `FLUSH_PROGRESS`: of 395
nails in trials the last measurement was off by 0.4 to 0.7 mm in 5 %, and one of 0.94 mm stood 1.3 mm high."""
SURE_SHARE_IN_NOISE = 0.3
"""The same share where touches are noisy, and good for half a millimetre. Over it one more strike follows; under it
none, because a strike on a flush nail is the hardest that an arm gets."""
STRIKES_BEFORE_SECOND_LOOK = 2
"""Number of strikes before the next look at a nail that looked bent."""
LET_IN = "the nail went deep into very soft wood: check it"
"""What else may have become of a nail that is not where it should be after strikes."""
STEADY_FACTOR = 3
"""How many times as many strikes a tool may do before the next look that has hardly slipped between the last two."""
NEARLY_FLUSH = 0.003
"""Height of a nail that the next measurement may find flush [m]: a face that has tilted by 4° since the last look meets
the wood with its rim, and makes the nail seem 1 mm lower."""
BLIND_MISSES = 3
"""Number of successive misses after which the uncorrected baseline gives up."""
STRIKES_BEFORE_GIVING_UP, LEAST_SHARE = 10, 0.5
"""Number of strikes after which the forecast may end the job, and the share of its further strikes that must be over
`task.max_strikes` for that: a forecast is good to a factor of two."""
MOST_TOLD = 3.0
"""Further strikes that a person is told would do, at most, in those that were permitted."""
FLUSH_PROGRESS = 0.0005
"""Largest progress of a strike on a flush nail [m]."""


@dataclass
class _Course:
    """What successive measurements of one run say.

    Attributes:
        stall: The strikes that seem not to have moved the nail.
        flush: Number of successive measurements of a flush nail.
        progress: Mean progress of the strikes since the measurement before the last one [m].
        home: Whether the next strike is the last one, of a nail that was measured to be flush.
        doubted: Whether the tool was looked at because the nail seemed to stand still.
    """

    stall: NailStall
    flush: int = 0
    progress: float = np.inf
    home: bool = False
    doubted: bool = False


class NailDriving:
    """The strikes on one nail.

    Args:
        motions: The arm and its motions.
        config: Configuration of the station with this nail.
        look: Looks at the tool; None for the baseline, which strikes with the nominal pose in the hand.

    Attributes:
        protrusion: Height of the nail's head over the wood as measured last [m]; None before `run`.
        seconds: Time that the nail has taken so far, from the first look's end on [s], station clock.
    """

    def __init__(self, motions: Motions, config: StationConfig, look: Look | None) -> None:
        self.protrusion: float | None = None
        self.seconds = 0.0
        self._motions, self._config, self._look_at = motions, config, look
        self._watch = NailWatch(config, motions.observer)
        self._striking = Striking(motions, config)
        self._gauge = NailGauge(motions, config)
        self._forecast = NailForecast(config.work.nail_length, config.task.flush_protrusion, motions.arm.rate)
        self._measured = False
        self._taken: Touches | None = None  # of the measurement that the forecast has
        self._missed = 0  # strikes one after the other that did not meet the nail
        self._seen_too_near = 0.0  # along the face's normal, by the first touch after the first look [m]

    @property
    def strikes(self) -> tuple[Strike, ...]:
        """The strikes done so far."""
        return tuple(self._striking.done)

    def run(self, held: HeldTool) -> tuple[Outcome, str]:
        """Strike until the nail is flush or another end condition holds; once more after an interruption.

        The tool was looked at just before. After an interruption the nail is measured first: the interrupted strike may
        have driven it. What has become of the tool, `Motions.held` tells.

        Args:
            held: What the hand holds.

        Returns:
            The outcome, and the reason for a person.

        Raises:
            JobEnded: The nail was not met as expected.
            TooleeError: A motion or a plan failed.
        """
        clock = self._motions.station.clock
        began = clock.now()
        try:
            return self._run(self._begin(held))
        finally:
            self.seconds += clock.now() - began

    def _run(self, held: HeldTool) -> tuple[Outcome, str]:
        course = _Course(NailStall(self._config.task.min_progress))
        while True:
            if (end := self._ended(course)) is not None:
                return end
            before = self._forecast.height
            plan, measured, held = self._strike_or_miss(course, held)
            if course.home and measured is None:
                return self._flush(f"the head stood {before * 1e3:z.1f} mm over the wood before the last strike")
            if self._missed:
                continue
            held = held.turned()
            if measured is not None:
                end, held = self._judged(course, plan, measured, held)
                if end is not None:
                    return end

    def _ended(self, course: _Course) -> tuple[Outcome, str] | None:
        """The end of a nail that needs no further strike, or gets none; None where it is struck."""
        task, forecast, height = self._config.task, self._forecast, self._forecast.height
        # Another strike confirms it: after slip a measurement is accurate only to half a millimetre.
        course.flush = course.flush + 1 if height <= task.flush_protrusion and not forecast.unmeasured else 0
        sure = forecast.finished and height <= SURE_SHARE * task.flush_protrusion
        two = course.flush == 2 and course.progress < FLUSH_PROGRESS
        done = course.flush > 2 or (two and height <= SURE_SHARE_OF_TWO * task.flush_protrusion)
        done = done or (course.flush > 0 and sure)
        struck = len(self.strikes)
        known = struck >= STRIKES_BEFORE_GIVING_UP and not forecast.unmeasured and math.isfinite(forecast.left)
        out_of_strikes = struck >= task.max_strikes or (
            known and struck + LEAST_SHARE * forecast.left > task.max_strikes
        )
        surely = not self._gauge.noisy or height <= SURE_SHARE_IN_NOISE * task.flush_protrusion
        if done and (surely or course.home or out_of_strikes):
            return self._flush(f"the head stands {height * 1e3:z.1f} mm over the wood")
        course.home = done
        if out_of_strikes:
            end = f"after {struck} strikes the head stands {height * 1e3:z.1f} mm over the wood"
            if 0 < forecast.left < MOST_TOLD * task.max_strikes:
                more = math.ceil(1.2 * forecast.left)
                end += (
                    f". It still moves, and needs about {more} more strikes: raise task.max_strikes "
                    f"({task.max_strikes}), or permit faster strikes (arm.acceleration, strike.deepest)"
                )
            elif struck < task.max_strikes:
                end += f". The forecast is far more than {task.max_strikes} strikes: permit faster strikes"
            return Outcome.OUT_OF_STRIKES, f"{end}, not confirmed by another strike" if course.flush else end
        if self._striking.too_hard:
            raise JobEnded(Outcome.OVERLOAD, self._striking.too_hard)
        return None

    def _flush(self, words: str) -> tuple[Outcome, str]:
        """The end of a nail that reads flush: not believed if no strike was felt where the nail should be."""
        if self.strikes and all(strike.meeting is not Meeting.EXPECTED for strike in self.strikes):
            return Outcome.NAIL_MISSED, f"{words}, but no strike met it where it should be. Check the nail"
        return Outcome.FLUSH, words

    def _strike_or_miss(self, course: _Course, held: HeldTool) -> tuple[StrikePlan, float | None, HeldTool]:
        """Strike once, after a look where one is due: the plan, the height measured after it [m], and the tool."""
        task, height = self._config.task, self._forecast.height
        if self._look_due(held, held.strikes) and height > task.flush_protrusion:
            held = self._look(held, task.views_again)
        with self._motions.stages(Stage.PLAN):
            plan = self._striking.plan(height, held)
        self._missed += 1
        measured = None
        try:
            measured, held = self._strike_nail(plan, height, held, home=course.home)
            self._missed = 0
        except JobEnded as end:
            held = self._after_miss(end)
            course.home = False
        return plan, measured, held

    def _after_miss(self, end: JobEnded) -> HeldTool:
        """Look again after the first strike that misses the nail; the second successive one ends the job.

        The baseline exists to show the effect of striking without correction: it goes on, up to BLIND_MISSES.
        """
        if end.outcome is not Outcome.NAIL_MISSED or self._missed > (BLIND_MISSES - 1 if self._look_at is None else 1):
            raise end
        if self._look_at is None:
            self._motions.observer.message(f"{end}; the job strikes on, because this variant does not correct")
            return self._motions.held
        self._motions.observer.message(f"{end}; looking again")
        return self._look(self._motions.held, self._config.task.views)

    def _judged(
        self, course: _Course, plan: StrikePlan, measured: float, held: HeldTool
    ) -> tuple[tuple[Outcome, str] | None, HeldTool]:
        """What a measurement after a strike says: the end, if it is one; and the tool, which may be looked at again."""
        task, forecast, stall = self._config.task, self._forecast, course.stall
        struck, expected = forecast.unmeasured, forecast.expected
        before = self._gauge.protrusion(self._taken) if self._taken else None
        course.progress = forecast.measured(measured, before)
        self._taken, self.protrusion = self._gauge.latest, measured
        sank = max(course.progress, forecast.below)  # at least, in one strike: a mean hides one among several
        if sank > self._deepest(held):
            return (Outcome.BENT, f"the head sank {sank * 1e3:.1f} mm in one strike: the nail has bent"), held
        if self.strikes[-1].meeting is not Meeting.EXPECTED and measured <= task.flush_protrusion:
            # Beside a nail that it has missed the face meets the wood at once, which reads flush.
            held = self._look(held, task.views_again)
        stall.measured(struck, course.progress, expected)
        if stall.strikes >= FEWEST and measured <= task.flush_protrusion:
            words = f"{stall.strikes} strikes moved it no further, {measured * 1e3:z.1f} mm over the wood"
            return self._flush(words), held
        if not stall.over:
            course.doubted = course.doubted and stall.suspected
            return None, held
        if course.doubted or self._look_at is None:
            slow = "strike.speed asks for" if plan.speed >= 0.99 * plan.wanted_speed else "arm and hand permit"
            reason = (
                f"{stall}, and it stands {measured * 1e3:z.1f} mm over the wood. It has met something hard, or the "
                f"{plan.speed:.2f} m/s that {slow} are too slow"
            )
            return (Outcome.STUCK, reason), held
        # The edge of a face that has tilted in the hand meets the wood before the nail is flush.
        course.doubted = True
        stall.again()
        return None, self._look(held, task.views)

    def _deepest(self, held: HeldTool) -> float:
        """Depth that a strike can drive the nail at most [m]."""
        return deepest_strike(held.payload.mass, self._config.strike.speed)

    def _look_due(self, held: HeldTool, strikes: int) -> bool:
        """Whether to look again after so many strikes; not if a steadily held tool is about to finish the nail."""
        if self._watch.suspected:
            return strikes >= STRIKES_BEFORE_SECOND_LOOK
        usual = self._config.task.strikes_between_looks * (STEADY_FACTOR if held.steady else 1)
        return strikes >= usual and not (held.steady and strikes + self._forecast.left <= 1.5 * usual)

    def _look(self, held: HeldTool, views: int) -> HeldTool:
        if self._look_at is None:
            return replace(held, strikes=0)
        # The camera's and the arm's errors are those of the look before, which the touch has told along the normal.
        held = self._look_at(held, views).shifted(self._seen_too_near)
        self._watch.look(held.frames, self._forecast.height, self._forecast.sigma)
        return held

    def _begin(self, held: HeldTool) -> HeldTool:
        """Touch the nail: its height is known, but for an interruption, and the face's place along it is not.

        A nail that is not met is touched once more, after a look at the tool that does not believe the one before.
        """
        self._missed, held = 0, replace(held, strikes=0, steady=False, turn=(0.0, 0.0, 0.0))
        known = self._config.work.nail_protrusion if self.protrusion is None else self._forecast.height
        try:
            height, held = self._first_touch(known, held)
        except JobEnded as end:
            if self._look_at is None or end.outcome is not Outcome.NAIL_MISSED:
                raise
            self._motions.observer.message(f"{end}; looking again")
            held = self._look(self._motions.held.forgotten(), self._config.task.views)
            height, held = self._first_touch(known, held)
        self._forecast.measured(height)
        self._taken, self.protrusion = self._gauge.latest, height
        # Not before: where the nail is not, or not as high as the file has it, something else looks like a nail.
        others = [nail_of(body) for body in self._motions.in_the_way]
        self._watch.look(held.frames, height, self._forecast.sigma, others)
        return held

    def _first_touch(self, known: float, held: HeldTool) -> tuple[float, HeldTool]:
        """Touch a nail that protrudes by `known` [m], but for an interruption: its protrusion [m], and the tool."""
        with self._motions.stages(Stage.PLAN):
            plan = self._striking.plan_touch(known, held)
        with self._motions.stages(Stage.TOUCH):
            try:
                if self._measured:
                    return self._gauge.resume(plan, known, held)
                touched = self._gauge.begin(plan, held)
            except JobEnded as end:
                if self._look_at is not None:
                    raise
                return known, self._after_miss(end)
        self._seen_too_near = float((inverse(held.X_hand_ee) @ touched.X_hand_ee)[2, 3])
        self._measured = True
        return known, touched

    def _strike_nail(
        self, plan: StrikePlan, before: float, held: HeldTool, *, home: bool
    ) -> tuple[float | None, HeldTool]:
        """Strike a nail that protrudes by `before` [m], as far as is known.

        A strike that was executed is recorded, whatever comes after it.

        Args:
            plan: The strike.
            before: Protrusion before it [m].
            held: What the hand holds.
            home: Whether it is the last one, of a nail that was measured to be flush.

        Returns:
            The protrusion measured after it [m], None where the forecast is good enough; and the tool.

        Raises:
            JobEnded: The strike, or the touch after it, does not meet the nail.
        """
        with self._motions.stages(Stage.STRIKE):
            report, verdict = self._striking.swing(plan, held)
            held = held.struck()
            load = self._striking.load(plan, report)
            measure = self._measure_after(plan, verdict, home=home)
        height = None
        try:
            with self._motions.stages(Stage.STRIKE):
                self._striking.retract(plan, held)
            if verdict.meeting is Meeting.EARLY:
                raise JobEnded(Outcome.NAIL_MISSED, f"{verdict}: the nail is not at the point of the strike")
            if measure:
                height, held = self._touch_after(plan, before, verdict, held)
            return height, held
        finally:
            self._striking.record(plan, report, verdict, load, height)

    def _measure_after(self, plan: StrikePlan, verdict: ContactVerdict, *, home: bool) -> bool:
        """Whether to measure the nail after a strike: not if the forecast is good enough."""
        if verdict.meeting is not Meeting.EXPECTED:
            if verdict.meeting in (Meeting.LATE, Meeting.NONE):
                self._forecast.unfelt(f"{verdict}: checking by touch whether the nail was hit")
            return True
        unsure = self._forecast.struck(verdict, plan.speed)
        last = len(self.strikes) + 1 >= self._config.task.max_strikes or self._striking.too_hard
        return not home and bool(unsure or last or self._watch.suspected)

    def _touch_after(
        self, plan: StrikePlan, before: float, verdict: ContactVerdict, held: HeldTool
    ) -> tuple[float, HeldTool]:
        """Touch the nail after a strike: what it protrudes by [m], and the tool. See `_strike_nail`."""
        met = verdict.meeting is Meeting.EXPECTED
        if self._forecast.surprise:
            self._motions.observer.message(self._forecast.surprise)
        often, looked = self._config.task.strikes_between_looks, False
        if self._look_at is not None and held.strikes > often and self._forecast.height < NEARLY_FLUSH:
            held, looked = self._look(held, self._config.task.views_again), True
        try:
            with self._motions.stages(Stage.TOUCH):
                if looked or self._striking.leans:
                    self._gauge.go_over(self._striking.plan_touch(before, held), held)
                else:  # after a strike the face is no longer square to the nail
                    self._gauge.go_over(plan, held, near=True)
                # With a corrected face pose, a head that is no longer there after a strike means a bent nail.
                missed = Outcome.BENT if met and self._look_at is not None else Outcome.NAIL_MISSED
                height, held = self._gauge.measure(before, held, self._forecast.unknown, missed)
        except JobEnded as end:
            if end.outcome is Outcome.BENT:
                gone = f"the strike met the nail. Either it bent, or {LET_IN} ({end})"
                raise JobEnded(Outcome.BENT, gone) from end
            if met:
                raise
            raise JobEnded(end.outcome, f"{verdict}: the nail is not at the point of the strike ({end})") from end
        # Those that missed before this one have driven nothing: two misses would permit what neither alone does.
        may_have_driven = self._forecast.unknown - (self._missed - 1)
        if not met and before - height > may_have_driven * self._deepest(held):
            raise JobEnded(Outcome.NAIL_MISSED, f"{verdict}: the nail is not at the point of the strike, or {LET_IN}")
        return height, held
