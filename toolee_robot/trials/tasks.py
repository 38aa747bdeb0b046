"""What is run for a trial: the options of `toolee hammer`, the files that they name, and the tries of a job."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from toolee_robot.errors import UserError
from toolee_robot.runtime.files import write_atomic
from toolee_robot.trials.plan import Arm, Trial, TrialPlan
from toolee_robot.trials.results import Record

RUNS = "runs"
"""The folder with the jobs' folders."""
ERRORS, SETUPS = "errors", "setups"
"""The folders with the sizes of the errors and with what is set up, where the plan gives them."""
TRIES = 6
"""Number of times that a job is tried which ends because the machine itself stalled."""

Job = Callable[[Sequence[str]], dict[str, Any]]
"""Runs `toolee hammer` with options, and returns its figures."""


@dataclass(frozen=True)
class Task:
    """The job of a trial.

    Attributes:
        trial: The trial.
        command: Options of `toolee hammer` that repeat it.
        out: Parent of the job's folder.
    """

    trial: Trial
    command: tuple[str, ...]
    out: Path

    @property
    def options(self) -> tuple[str, ...]:
        """Options with which the trials run it."""
        return ("--json", "--out", str(self.out), *self.command)


def task_of(plan: TrialPlan, trial: Trial, folder: Path) -> Task:
    """Write the files of a trial's job, and make its options.

    Args:
        plan: The plan.
        trial: The trial.
        folder: The trials' folder.

    Returns:
        The task.
    """
    command = (
        *(() if plan.on_robot else ("--seed", str(trial.seed))),
        *trial.arm.options, *_needed(plan, trial),
        *_errors(plan, trial, folder), *_setup(plan, trial, folder),
        *(() if trial.sensor is None else ("--sensor", trial.sensor)), *plan.options,
    )  # fmt: skip
    return Task(trial, command, out_of(trial, folder))


def out_of(trial: Trial, folder: Path) -> Path:
    """Where the folder of a trial's job lies: jobs of one seed that begin in the same second need folders of their own.

    Args:
        trial: The trial.
        folder: The trials' folder.

    Returns:
        The parent of the job's folder.
    """
    return folder / RUNS / trial.arm / trial.variation


def run_task(job: Job, task: Task) -> Record:
    """Run a trial's job, again where the machine itself stalled.

    Args:
        job: Runs it.
        task: The task.

    Returns:
        Its result.

    Raises:
        TooleeError: It did not come to an end of its own; code `trials.crashed`.
    """
    figures, tries = job(task.options), 1
    while figures.get("machine_stalled") and tries < TRIES:
        figures, tries = job(task.options), tries + 1
    return Record(task.trial, {**figures, "tries": tries}, task.command)


def check_needed(plan: TrialPlan, folder: Path, done: Iterable[Record]) -> None:
    """Read what some of the plan's arms alone need, before the first job: the paper's weights, the jobs learnt from.

    Args:
        plan: The plan.
        folder: The trials' own folder.
        done: The results that there are.

    Raises:
        AssetError: The weights of the paper's estimator are missing or unreadable.
        UserError: These are for clouds of whole tools (`user.paper_column`), or others than those of the results
            (`user.other_weights`); the folder of the jobs learnt from is unfit (as of `learn_shifts`), holds the
            trials' own or lies in it (`user.learnt_from_own`), or has other jobs than when the results were made
            (`user.other_jobs`).
    """
    if plan.paper_weights:
        _check_paper_weights(Path(plan.paper_weights), done)
    if plan.learnt_from:
        _check_learnt_from(Path(plan.learnt_from), folder, done)


def _check_paper_weights(folder: Path, done: Iterable[Record]) -> None:
    # Networks take seconds to import, which no other plan needs here.
    from toolee_robot.perception.offline.research.tooleenet import PaperEstimator
    from toolee_robot.perception.weight_files import weights_hash

    PaperEstimator.load_for_job(folder)
    now = weights_hash(folder)
    before = {record.figures.get("paper_weights") for record in done if record.trial.arm is Arm.PAPER} - {now}
    if before:
        raise UserError(
            f"{folder} holds other weights ({now[:12]}) than those of the trials that are done "
            f"({', '.join(str(one)[:12] for one in before)}): put those back, or give another --out",
            code="user.other_weights",
        )


def _check_learnt_from(source: Path, folder: Path, done: Iterable[Record]) -> None:
    from toolee_robot.tasks.hammering.learnt_grasp import learn_shifts  # takes a second to import

    earlier, own = source.resolve(), folder.resolve()
    if earlier == own or earlier in own.parents or own in earlier.parents:
        raise UserError(
            f"learnt_from: {source} and the trials' own folder {folder} hold one another, and the trials "
            "would learn from themselves: give folders of their own",
            code="user.learnt_from_own",
        )
    now = {shift.figures["sha256"] for shift in learn_shifts(source).values()}
    records = (record.figures.get("learnt_grasp") for record in done if record.trial.arm is Arm.LEARNT_GRASP)
    if {figures["sha256"] for figures in records if figures} - now:
        raise UserError(
            f"learnt_from: {source} holds other jobs than when the finished trials learnt from it: put those "
            "back, or give another --out",
            code="user.other_jobs",
        )


def _needed(plan: TrialPlan, trial: Trial) -> tuple[str, ...]:
    """Options for what an arm alone needs."""
    if trial.arm is Arm.LEARNT_GRASP:
        return ("--learnt-from", plan.learnt_from)
    return ("--paper-weights", plan.paper_weights) if trial.arm is Arm.PAPER else ()


def _errors(plan: TrialPlan, trial: Trial, folder: Path) -> tuple[str, ...]:
    """Options for a trial's errors."""
    if plan.errors == "exact":
        return ("--exact",)
    sizes = dict(plan.errors) if isinstance(plan.errors, dict) else {}
    if trial.error is not None and trial.size is not None:
        sizes[trial.error] = trial.size
    swept = "all" if trial.error is None else f"{trial.error}-{trial.size:g}"
    return ("--errors", str(_written(folder / ERRORS / f"{swept}.yaml", sizes))) if sizes else ()


def _setup(plan: TrialPlan, trial: Trial, folder: Path) -> tuple[str, ...]:
    """Options for what a trial has of its own in the place of the station's."""
    own = plan.setup(trial)
    options = ("--setup", str(_written(folder / SETUPS / f"{trial.put_there}.yaml", own))) if own else ()
    return (*options, "--nail", str(trial.nail)) if trial.nail in plan.nails else options


def _written(file: Path, content: Mapping[str, Any]) -> Path:
    if not file.is_file():
        file.parent.mkdir(exist_ok=True)
        write_atomic(file, yaml.safe_dump(content).encode())
    return file
