"""The results of a plan's trials on the disk: `trials.jsonl`, whose first line is the plan, then one line a result.

Trials that a person is led through have lines for what else happened, too: skipped, void, interrupted. Shares with
intervals and paired comparisons are computed from the trials.
"""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from pydantic import TypeAdapter
from scipy.stats import binomtest

import toolee_robot
from toolee_robot.app.variant import Variant
from toolee_robot.errors import UserError, words_of
from toolee_robot.runtime.files import claimed, from_json, json_line, read_text, write_atomic
from toolee_robot.trials.plan import Trial, TrialPlan

RESULTS = "trials.jsonl"
"""The file with the results."""


@dataclass(frozen=True)
class Record:
    """Result of a trial.

    Attributes:
        trial: Which one.
        figures: The job's, and `tries`; of a trial with a person also what that measured.
        command: Words of the command that repeats it, after `toolee`.
    """

    trial: Trial
    figures: dict[str, Any]
    command: tuple[str, ...]

    @property
    def success(self) -> bool:
        """Whether the nail is flush."""
        return bool(self.figures["success"])

    @property
    def repeated_by(self) -> str:
        """How it is repeated, in words."""
        return f"toolee {shlex.join(self.command)}"


class Happened(StrEnum):
    """What else happened in trials with a person."""

    SESSION = "session"
    """The command was started."""
    BEGUN = "begun"
    """The person is ready; the job begins."""
    NOT_BEGUN = "not_begun"
    """The job could not begin, or did not come to an end of its own."""
    ENDED = "ended"
    """The job has ended, and the person has not measured yet; facts: its figures and its command."""
    VOID = "void"
    """The trial was not as the plan says; facts: the reason and the figures."""
    SKIPPED = "skipped"
    """The person skipped the trial; facts: the reason."""
    STOPPED = "stopped"
    """The person stopped, to go on later."""


@dataclass(frozen=True)
class Event:
    """Something that happened.

    Attributes:
        what: What.
        at: When, ISO 8601.
        trial: To which trial; None for none.
        facts: What there is to know of it.
    """

    what: Happened
    at: str
    trial: Trial | None = None
    facts: dict[str, Any] = field(default_factory=dict)


_RECORD, _EVENT = TypeAdapter(Record), TypeAdapter(Event)


class Results:
    """The results that a folder has, and the file to which new ones are added: each is on the disk at once.

    Args:
        plan: The plan.
        folder: Its folder; made where there is none.

    Attributes:
        done: The results.
        events: What else happened.

    Raises:
        UserError: When it is entered: the folder holds another plan's trials, its file is none of
            trials, or another process works on them.
    """

    def __init__(self, plan: TrialPlan, folder: Path) -> None:
        self._plan, self._path = plan, folder / RESULTS

    def __enter__(self) -> Self:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            stack.enter_context(claimed(self._path.parent))
            self.done, self.events = _begun(self._path, self._plan)
            self._file = stack.enter_context(self._path.open("a"))
            self._open = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    @property
    def records(self) -> list[Record]:
        """The results in the plan's order."""
        return [self.done[trial] for trial in self._plan.jobs() if trial in self.done]

    def add(self, record: Record) -> None:
        """Keep a result.

        Args:
            record: The result.
        """
        self._append({"trial": _trial(record.trial), "figures": record.figures, "command": record.command})
        self.done[record.trial] = record

    def note(self, what: Happened, trial: Trial | None = None, **facts: Any) -> None:
        """Keep what happened.

        Args:
            what: What.
            trial: To which trial.
            **facts: What there is to know of it, for JSON.
        """
        event = Event(what, now(), trial, facts)
        self._append({"event": {**asdict(event), "trial": None if trial is None else _trial(trial)}})
        self.events.append(event)

    def _append(self, line: dict[str, Any]) -> None:
        os.write(self._file.fileno(), (json_line(line) + "\n").encode())
        os.fsync(self._file.fileno())


def now() -> str:
    """The time, ISO 8601, to a second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def read_results(plan: TrialPlan, folder: Path) -> tuple[list[Record], list[Event]]:
    """Read what a plan's folder has.

    Args:
        plan: The plan.
        folder: Its folder.

    Returns:
        The results, in the plan's order, and what else happened; none where the folder has none.

    Raises:
        UserError: The folder holds another plan's trials.
    """
    path = folder / RESULTS
    return read_results_file(plan, path) if path.is_file() else ([], [])


def read_results_file(plan: TrialPlan, path: Path) -> tuple[list[Record], list[Event]]:
    """Read a file of results.

    Args:
        plan: Its plan.
        path: The file.

    Returns:
        The results, in the plan's order, and what else happened.

    Raises:
        UserError: The file cannot be read or holds no results, or another plan's.
    """
    done, events = _read(path, plan)
    return [done[trial] for trial in plan.jobs() if trial in done], events


def _begun(path: Path, plan: TrialPlan) -> tuple[dict[Trial, Record], list[Event]]:
    """Make the file, or read it and let it end with a whole line; what is not this plan's is not touched."""
    if not path.exists():
        head = {"plan": asdict(plan), "hash": plan.hash, "version": toolee_robot.__version__}
        write_atomic(path, (json.dumps(head) + "\n").encode())
    done = _read(path, plan)
    os.truncate(path, path.read_bytes().rfind(b"\n") + 1)  # a process may have been killed while it wrote
    return done


def _read(path: Path, plan: TrialPlan) -> tuple[dict[Trial, Record], list[Event]]:
    try:
        head, *rest = [from_json(line) for line in read_text(path).split("\n")[:-1]]
        other, named = head["hash"] != plan.hash, f"{head['plan']['name']!r} ({head['hash'][:12]})"
        records = [] if other else [_RECORD.validate_python(line) for line in rest if "event" not in line]
        events = [] if other else [_EVENT.validate_python(line["event"]) for line in rest if "event" in line]
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        why = words_of(error) if isinstance(error, OSError) else "it does not begin with a plan, or a line is damaged"
        raise UserError(f"{path} holds no results of trials: {why}") from error
    if other:
        raise UserError(
            f"{path} holds the trials of another plan, {named}; this one is {plan.hash[:12]}. A plan must not "
            "change once its trials have begun. Give another --out"
        )
    return {record.trial: record for record in records}, events


def _trial(trial: Trial) -> dict[str, Any]:
    return {name: value for name, value in asdict(trial).items() if value is not None}


@dataclass(frozen=True)
class Share:
    """A share with its 95 % interval.

    Attributes:
        hits: Number of successes.
        of: Number of trials.
        low: Lower bound (Wilson 1927).
        high: Upper bound.
    """

    hits: int
    of: int
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.hits} of {self.of} ({self.low:.2f} to {self.high:.2f})"


def share(successes: Sequence[bool]) -> Share:
    """Compute a share.

    Args:
        successes: Whether each trial succeeded; at least one.

    Returns:
        The share.
    """
    hits, of = int(sum(successes)), len(successes)
    interval = binomtest(hits, of).proportion_ci(method="wilson")
    return Share(hits, of, float(interval.low), float(interval.high))


@dataclass(frozen=True)
class Comparison:
    """An arm compared with another one on the same seeds.

    Attributes:
        pairs: Number of seeds that both have.
        better: Number of seeds where only the arm succeeded.
        worse: Number of seeds where only the other one did.
        p: Probability of a difference at least as large if there is none (exact test of McNemar 1947).
    """

    pairs: int
    better: int
    worse: int
    p: float


def compare(arm: Sequence[Record], other: Sequence[Record]) -> Comparison:
    """Compare two arms, pair by pair.

    Args:
        arm: Results of an arm.
        other: Results of the arm that it is compared with.

    Returns:
        The comparison.
    """
    reference = {replace(record.trial, arm=Variant.FULL): record.success for record in other}
    mine = [(r.success, replace(r.trial, arm=Variant.FULL)) for r in arm]
    pairs = [(success, reference[trial]) for success, trial in mine if trial in reference]
    better = sum(a and not b for a, b in pairs)
    worse = sum(b and not a for a, b in pairs)
    p = 1.0 if better + worse == 0 else float(binomtest(better, better + worse, 0.5).pvalue)
    return Comparison(len(pairs), better, worse, p)


def median(records: Sequence[Record], figure: str) -> float | None:
    """Median of a figure over the results that have it; None if none has."""
    known = [value for record in records if (value := record.figures.get(figure)) is not None]
    return float(np.median(known)) if known else None


def of_arm(records: Sequence[Record], arm: Variant) -> list[Record]:
    """The results of an arm.

    Args:
        records: All results.
        arm: The arm.

    Returns:
        Its results, in their order.
    """
    return [record for record in records if record.trial.arm is arm]


def by_conditions(records: Sequence[Record]) -> dict[str, list[Record]]:
    """Results by the names of tool, nail, wood and sensor in words; nothing where the plan lists none."""
    sorted_: dict[str, list[Record]] = {}
    for record in records:
        if words := record.trial.conditions:
            sorted_.setdefault(words, []).append(record)
    return sorted_
