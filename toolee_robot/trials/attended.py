"""Trials on a robot, or in a rehearsal: a person is led through them, one at a time, and measures what came out.

The outcome follows from what the person measures, not from what the robot believes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from toolee_robot.errors import ConfigError, TooleeError
from toolee_robot.frames import HALF_TURN
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.outcome import MAX_STOPS
from toolee_robot.trials.plan import InRehearsal, OnRobot, TrialPlan
from toolee_robot.trials.results import Event, Happened, Record, Results, now
from toolee_robot.trials.run import Job, Task, check_paper_weights, station_of, task_of, told

Ask = Callable[[str], str]
"""Shows a question and returns the line that was typed; raises EOFError where nobody can answer any more."""
NOT_MEASURABLE = "-"
"""The answer of a person who cannot measure a nail: it has come out, or its head has come off."""
DEEPEST = -20.0
"""[mm] Least height over the wood that is believed: no hammer drives a nail's head deeper."""


@dataclass(frozen=True)
class MeasuredNail:
    """A nail, as a person found it.

    Attributes:
        name: Its name.
        protrusion_mm: Height of the top of its head over the wood, by calipers [mm]; None where it cannot be measured.
        bent: Whether it leans by 10° or its head was pushed 3 mm aside.
        flush: Whether it is driven as a job must drive it.
    """

    name: str
    protrusion_mm: float | None
    bent: bool
    flush: bool


@dataclass(frozen=True)
class Judgement:
    """What a person found after a job.

    Attributes:
        nails: Each nail that was to be driven.
        slipped: Whether the tool slipped in the hand.
    """

    nails: tuple[MeasuredNail, ...]
    slipped: bool

    @property
    def flush(self) -> bool:
        """Whether every nail is."""
        return all(nail.flush for nail in self.nails)

    def outcome(self, figures: dict[str, Any]) -> dict[str, Any]:
        """The outcome of the trial: the person's, whatever the robot believes.

        What is asked of a job is a nail that is flush, and calipers tell it; the touch by which the robot measures it
        is a part of what is tried. The robot's own verdict stays beside it, as `robot`, and the report tells where they
        disagree. Where both say that the job failed, the cause is the robot's.

        Args:
            figures: The job's, as of `run_job`.

        Returns:
            The trial's.
        """
        robot = {name: figures[name] for name in ("success", "outcome", "reason")}
        made = {**figures, "success": self.flush, "robot": robot, "person": asdict(self)}
        if self.flush:
            made |= {"outcome": "flush", "reason": f"the person measured {self._heights()}"}
        elif robot["success"]:
            outcome = "bent" if any(nail.bent for nail in self.nails) else "not_flush"
            made |= {"outcome": outcome, "reason": f"the robot takes it for flush; the person found {self._heights()}"}
        return made

    def _heights(self) -> str:
        return ", ".join(
            f"{nail.name} {'not measurable' if nail.protrusion_mm is None else f'{nail.protrusion_mm:g} mm'}"
            f"{' and bent' if nail.bent else ''}"
            for nail in self.nails
        )


def judged(config: StationConfig, nails: Sequence[str], ask: Ask, tell: Callable[[str], object]) -> Judgement:
    """Ask a person for what only a person can measure. Every question is asked until it is answered.

    Args:
        config: What the job was told of the station.
        nails: Names of the nails that were to be driven.
        ask: Asks the person.
        tell: Tells the person why an answer is none.

    Returns:
        The answers.

    Raises:
        EOFError: Nobody answers.
    """
    flush = config.task.flush_protrusion * 1e3
    found = []
    for name, work in config.work.each():
        if name not in nails:
            continue
        of = f" {name}" if len(nails) > 1 else ""
        height = _height(
            f"Nail{of}: height of its head over the wood by calipers, in mm, negative if below ({NOT_MEASURABLE}: "
            "not measurable)? ",
            1e3 * work.nail_length, ask, tell,
        )  # fmt: skip
        bent = yes(f"Nail{of}: does it lean by 10° or more, or was its head pushed 3 mm aside? y: yes, n: no? ", ask)
        found.append(MeasuredNail(name, height, bent, height is not None and height <= flush and not bent))
    slipped = yes("Did the tool slip in the hand? y: yes, n: no? ", ask)
    return Judgement(tuple(found), slipped)


def yes(question: str, ask: Ask) -> bool:
    """Ask a question until it is answered with yes or no.

    Args:
        question: The question.
        ask: Asks the person.

    Returns:
        Whether the answer is yes.
    """
    return choice(question, "yn", ask) == "y"


def choice(question: str, letters: str, ask: Ask) -> str:
    """Ask a question until the answer begins with one of some letters.

    Args:
        question: The question, which says what the letters mean.
        letters: The letters.
        ask: Asks the person.

    Returns:
        The letter.
    """
    while True:
        answer = ask(question).strip().lower()[:1]
        if answer and answer in letters:
            return answer


def words(question: str, ask: Ask) -> str:
    """Ask a question until something is said.

    Args:
        question: The question.
        ask: Asks the person.

    Returns:
        The answer.
    """
    while not (answer := ask(question).strip()):
        pass
    return answer


def _height(question: str, length: float, ask: Ask, tell: Callable[[str], object]) -> float | None:
    while True:
        answer = ask(question).strip().replace(",", ".")
        if answer == NOT_MEASURABLE:
            return None
        try:
            height = float(answer)
        except ValueError:
            tell(f"{answer!r} is not a number")
            continue
        if DEEPEST <= height <= length:
            return height
        tell(f"{answer} mm: the nail is {length:g} mm long. Give the height of its head over the wood in mm")


READY = "r: ready, begin; s: skip this trial; q: stop, and continue later? "
"""The question before each trial."""
COUNTS = "Was everything as the plan says, so that the trial counts, however it ended? y: it counts, n: repeat it? "
"""The question after each trial."""
Tell = Callable[[str], object]


class _Stopped(Exception):
    """The person goes on later."""


def lead_trials(plan: TrialPlan, folder: Path, ask: Ask, tell: Tell, job: Job) -> list[Record]:
    """Lead a person through the trials of a plan that its folder does not have yet.

    Before each the person reads what to set up and says that it is so, skips the trial or stops; after it the person
    measures, and says whether it counts. A skipped one is not done: the same command asks for it again. As many stops
    with the tool in the hand as end a job end the session, too.

    Args:
        plan: The plan, with a person (`TrialPlan.led`).
        folder: Its folder; made where there is none.
        ask: Asks the person.
        tell: Tells the person.
        job: Does a job, whose observer prompts and asks the person. An interrupt that reaches it stops the arm.

    Returns:
        The results, in the plan's order; not all where the person skipped some or stopped.

    Raises:
        UserError: The folder holds another plan's trials; or as of `check_paper_weights`.
        AssetError: As of `check_paper_weights`.
        ConfigError: The station file is not complete, or lacks a tool or nail of the plan.
    """
    _check(plan, station_of(plan.where, None))
    with Results(plan, folder) as results:
        check_paper_weights(plan, results.records)
        order = plan.order()
        tell(f"{len(results.done)} of {len(order)} trials are done, in the plan's random order")
        results.note(Happened.SESSION)
        try:
            for i, trial in enumerate(order):
                if trial not in results.done:
                    if (stops := _stops(results.events)) >= MAX_STOPS:
                        tell(
                            f"the arm was stopped {stops} times with the tool in the hand in this session. Find the "
                            "cause before the next trial: payload, strike speed, or an obstacle"
                        )
                        raise _Stopped
                    _Led(results, ask, tell, job, plan).lead(task_of(plan, trial, folder), f"{i + 1} of {len(order)}")
        except (_Stopped, EOFError, KeyboardInterrupt) as stop:
            results.note(Happened.STOPPED)
            tell("stopped: run the same command again to continue")
            if isinstance(stop, KeyboardInterrupt):
                raise
        return results.records


def _check(plan: TrialPlan, station: StationConfig) -> None:
    own = None if station.tool is None else station.tool.name
    for tool in plan.tools:
        if isinstance(tool, str) and tool != own:
            raise ConfigError(
                f"tools: the station file's tool is {own or 'not given'}, the plan's {tool}. Give the plan the "
                "tool's data, as `tool` of a station file; with another hammer's data the face misses"
            )
    for nail in plan.nails:
        if isinstance(nail, str) and nail not in station.work.names:
            raise ConfigError(
                f"nails: the station's are {', '.join(station.work.names)}, and the plan names {nail}: give its sizes"
            )


def _digest(plan: TrialPlan) -> str:
    """SHA-256 of the station file, which a lab may change between trials."""
    match plan.where:
        case InRehearsal(station) | OnRobot(station):
            return hashlib.sha256(Path(station).read_bytes()).hexdigest()
    raise AssertionError("a person is led through trials with a station file alone")


def _stops(events: Sequence[Event]) -> int:
    """How often the arm was stopped with the tool in the hand in the session that goes on."""
    begun = max(i for i, event in enumerate(events) if event.what is Happened.SESSION)
    return sum(event.facts["figures"].get("stops", 0) for event in events[begun:] if event.what is Happened.ENDED)


@dataclass(frozen=True, eq=False)
class _Led:
    """Leads a person through trials."""

    results: Results
    ask: Ask
    tell: Tell
    job: Job
    plan: TrialPlan

    def lead(self, task: Task, number: str) -> None:
        trial, results = task.trial, self.results
        while trial not in results.done:
            last = [event for event in results.events if event.trial == trial][-1:]
            if last and last[0].what is Happened.ENDED:  # the person has not measured yet
                self._measure(task, number, last[0].facts["figures"])
                continue
            if last and last[0].what is Happened.BEGUN:
                self.tell("The command ended during this trial, so it is repeated.")
            for line in self._card(task, number):
                self.tell(line)
            answer = choice(READY, "rsq", self.ask)
            if answer == "q":
                raise _Stopped
            if answer == "s":
                results.note(Happened.SKIPPED, trial, reason=words("Why is it skipped? ", self.ask))
                return
            self._do(task)

    def _card(self, task: Task, number: str) -> list[str]:
        """What the person sets up."""
        trial, config = task.trial, task.spec.source.config
        sheet = config.tool
        tool = "the station file names none" if sheet is None else f"{sheet.name}, {sheet.weight_in_words}"
        lines = [
            "",
            f"Trial {number}: variant {trial.arm.replace('_', ' ')}, repetition {trial.seed}",
            f"  tool  {tool}; the robot asks for it",
        ]
        for name, work in config.work.each():
            if name in _nails(task):
                hole, at = work.pilot_hole_diameter * 1e3, HALF_TURN[:2, :2] @ work.nail_xy
                lines.append(
                    f"  nail  {trial.nail or name}: {work.nail_diameter * 1e3:g} x {work.nail_length * 1e3:g} mm, head "
                    f"{work.nail_head_diameter * 1e3:g} mm, {work.nail_protrusion * 1e3:g} mm over the wood, "
                    f"{f'pilot hole {hole:g} mm' if hole else 'no pilot hole'}; a new one, upright, at x "
                    f"{at[0]:.3f} m, y {at[1]:.3f} m in the Base of the teach pendant"
                )
        wood = f"{trial.wood}, " if trial.wood else ""
        lines.append(f"  wood  {wood}specific gravity {config.work.wood_specific_gravity:g}")
        return [*lines, *(f"  {line}" for line in self.plan.instructions.splitlines())]

    def _do(self, task: Task) -> None:
        trial, results = task.trial, self.results
        results.note(Happened.BEGUN, trial, station=_digest(self.plan))
        begun = now()
        try:
            figures = self.job(task.spec, task.out)
        except (TooleeError, KeyboardInterrupt) as error:
            reason = str(error) or "it was interrupted before it began"
            results.note(Happened.NOT_BEGUN, trial, reason=reason)
            self.tell(f"The job did not end by itself, and does not count: {reason}")
            return
        results.note(Happened.ENDED, trial, figures={**figures, "begun": begun}, command=task.command)

    def _measure(self, task: Task, number: str, figures: dict[str, Any]) -> None:
        trial, results = task.trial, self.results
        self.tell(f"Trial {number}: measure, whatever the robot reports.")
        judgement = judged(task.spec.source.config, _nails(task), self.ask, self.tell)
        made = judgement.outcome(figures)
        if not yes(COUNTS, self.ask):
            reason = words("What was not as the plan says? ", self.ask)
            results.note(Happened.VOID, trial, reason=reason, figures=made)
            return
        tries = sum(event.trial == trial and event.what is Happened.BEGUN for event in results.events)
        record = Record(trial, {**made, "number": int(number.split()[0]), "tries": tries}, tuple(task.command))
        results.add(record)
        self.tell(told(record))


def _nails(task: Task) -> tuple[str, ...]:
    """Those that are to be driven."""
    return task.spec.nails or task.spec.source.config.work.names
