"""Run the jobs of a plan, each in a process of its own, and keep every result as soon as there is one.

A folder holds one plan's trials: `trials.jsonl`, whose first line is the plan and then one line a finished job, and
`runs/` with the jobs' own folders. A run that was killed goes on where it stopped when it is started again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import yaml

import toolee_robot
from toolee_robot.errors import UserError
from toolee_robot.runtime.files import write_atomic
from toolee_robot.trials.plan import Arm, Trial, TrialPlan
from toolee_robot.trials.process import run_job

RESULTS = "trials.jsonl"
"""The file with the results."""
RUNS = "runs"
"""The folder with the jobs' folders."""
ERRORS = "errors"
"""The folder with the sizes of the errors, where the plan gives sizes."""
TRIES = 6
"""Number of times that a job is tried which ends because the machine itself stalled."""


_WRITING = Lock()


@dataclass(frozen=True)
class Record:
    """Result of a trial.

    Attributes:
        trial: Which one.
        figures: What `toolee hammer --json` printed, and `tries`.
        command: Options of `toolee hammer` that repeat it.
    """

    trial: Trial
    figures: dict[str, Any]
    command: tuple[str, ...]

    @property
    def success(self) -> bool:
        """Whether the nail is flush."""
        return bool(self.figures["success"])


Job = Callable[[Sequence[str]], dict[str, Any]]
"""Runs `toolee hammer` with options, and returns its figures."""


def run_trials(
    plan: TrialPlan,
    folder: Path,
    jobs: int = 1,
    tell: Callable[[str], object] = print,
    job: Job | None = None,
) -> list[Record]:
    """Run the trials of a plan that its folder does not have yet.

    Args:
        plan: The plan.
        folder: Its folder; made where there is none.
        jobs: Number of jobs side by side.
        tell: Told of each finished job.
        job: Runs a job; None for `toolee hammer` in a process of its own.

    Returns:
        All results, in the plan's order.

    Raises:
        UserError: The folder holds another plan's trials; code `user.other_plan`.
        TooleeError: A job did not come to an end of its own; code `trials.crashed`. Finished ones are kept.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / RESULTS
    done = _begin(path, plan)
    todo = [trial for trial in plan.jobs() if trial not in done]
    if done:
        tell(f"{len(done)} of {len(done) + len(todo)} trials are there already")
    with path.open("a") as file, ThreadPoolExecutor(jobs) as pool:
        waiting: dict[Future[Record], Trial] = {}
        queue = iter(todo)
        try:
            while True:
                for trial in queue:
                    waiting[pool.submit(_run, plan, trial, folder, job or run_job)] = trial
                    if len(waiting) >= jobs:
                        break
                if not waiting:
                    break
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    record = future.result()
                    del waiting[future]
                    _append(file.fileno(), _line(record))
                    done[record.trial] = record
                    tell(_told(record))
        finally:
            for future in waiting:
                future.cancel()
    return [done[trial] for trial in plan.jobs()]


def finished(plan: TrialPlan, folder: Path) -> list[Record]:
    """Read the results that a plan's folder has.

    Args:
        plan: The plan.
        folder: Folder of `run_trials`.

    Returns:
        The results, in the plan's order; none where the folder has none.

    Raises:
        UserError: The folder holds another plan's trials; code `user.other_plan`.
    """
    path = folder / RESULTS
    done = _read(path, plan) if path.is_file() else {}
    return [done[trial] for trial in plan.jobs() if trial in done]


def _begin(path: Path, plan: TrialPlan) -> dict[Trial, Record]:
    """The results that there are, and a file that ends with a whole line."""
    data = path.read_bytes() if path.exists() else b""
    if data:  # a process may have been killed while it wrote
        os.truncate(path, data.rfind(b"\n") + 1)
    if b"\n" not in data:
        head = {"plan": asdict(plan), "hash": plan.hash, "version": toolee_robot.__version__}
        write_atomic(path, (json.dumps(head) + "\n").encode())
    return _read(path, plan)


def _read(path: Path, plan: TrialPlan) -> dict[Trial, Record]:
    lines = path.read_text().splitlines(keepends=True)
    head, *results = [json.loads(line) for line in lines if line.endswith("\n")]
    if head["hash"] != plan.hash:
        raise UserError(
            f"{path} holds the trials of another plan, {head['plan']['name']!r} ({head['hash'][:12]}): this one is "
            f"{plan.hash[:12]}. A plan is not changed once its trials have begun: give another --out",
            code="user.other_plan",
        )
    return {record.trial: record for record in map(_record, results)}


def _append(file: int, line: str) -> None:
    os.write(file, line.encode())
    os.fsync(file)


def _line(record: Record) -> str:
    trial = {name: value for name, value in asdict(record.trial).items() if value is not None}
    return json.dumps({"trial": trial, "figures": record.figures, "command": record.command}) + "\n"


def _record(line: dict[str, Any]) -> Record:
    trial = Trial(**{**line["trial"], "arm": Arm(line["trial"]["arm"])})
    return Record(trial, line["figures"], tuple(line["command"]))


def _run(plan: TrialPlan, trial: Trial, folder: Path, job: Job) -> Record:
    command = ("--seed", str(trial.seed), *trial.arm.options, *_errors(plan, trial, folder / ERRORS), *plan.options)
    # Jobs of one seed that begin in the same second need folders of their own.
    options = ["--json", "--out", str(folder / RUNS / trial.arm / trial.variation), *command]
    figures, tries = job(options), 1
    while figures.get("machine_stalled") and tries < TRIES:
        figures, tries = job(options), tries + 1
    return Record(trial, {**figures, "tries": tries}, command)


def _errors(plan: TrialPlan, trial: Trial, folder: Path) -> tuple[str, ...]:
    """Options of `toolee hammer` for a trial's errors."""
    if plan.errors == "exact":
        return ("--exact",)
    sizes = dict(plan.errors) if isinstance(plan.errors, dict) else {}
    if trial.error is not None and trial.size is not None:
        sizes[trial.error] = trial.size
    if not sizes:
        return ()
    file = folder / f"{trial.variation or 'all'}.yaml"
    with _WRITING:  # jobs side by side may have the same one
        if not file.is_file():
            folder.mkdir(exist_ok=True)
            write_atomic(file, yaml.safe_dump(sizes).encode())
    return ("--errors", str(file))


def _told(record: Record) -> str:
    figures = record.figures
    ending = "flush" if record.success else f"failed: {figures['reason']}"
    tries = "" if figures["tries"] == 1 else f", try {figures['tries']}: the machine had stalled"
    swept = "" if record.trial.error is None else f", {record.trial.error} {record.trial.size:g}"
    return f"{record.trial.arm}, seed {record.trial.seed}{swept}: {ending}{tries}"
