"""What is run for a trial: its job, the command that repeats it, the files which that names, and the tries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from toolee_robot.app.variant import Variant
from toolee_robot.errors import UserError
from toolee_robot.runtime.files import write_atomic
from toolee_robot.station import StationConfig
from toolee_robot.trials.plan import InRehearsal, InSimulation, OnRobot, Trial, TrialPlan, Where, slug
from toolee_robot.trials.results import Record
from toolee_robot.types import ArmModel

if TYPE_CHECKING:
    from toolee_robot.app.job import JobSpec
    from toolee_robot.app.sources import Source

RUNS = "runs"
"""The folder with the jobs' folders."""
ERRORS, SETUPS = "errors.yaml", "setups"
"""The file with the sizes of the errors and the folder with what is set up, where the plan gives them."""
TRIES = 6
"""Number of times that a job is tried which ends because the machine itself stalled."""

Job = Callable[["JobSpec", Path], dict[str, Any]]
"""Does a job whose folder goes into another one, and returns its figures."""


@dataclass(frozen=True, eq=False)
class Task:
    """The job of a trial.

    Attributes:
        trial: The trial.
        spec: Its job.
        command: Words of the command that repeats it, after `toolee`.
        out: Parent of the job's folder.
    """

    trial: Trial
    spec: JobSpec
    command: tuple[str, ...]
    out: Path


def task_of(plan: TrialPlan, trial: Trial, folder: Path) -> Task:
    """Write the files of a trial's job, and make it.

    Args:
        plan: The plan.
        trial: The trial.
        folder: The trials' folder.

    Returns:
        The task.
    """
    from toolee_robot.app.job import JobSpec  # takes seconds to import, which no report needs

    own = plan.setup(trial)
    setup = _written(folder / SETUPS / f"{'-'.join(map(slug, trial.put_there))}.yaml", own) if own else None
    errors = plan.errors if isinstance(plan.errors, str) else str(_written(folder / ERRORS, plan.errors))
    nails = (str(trial.nail),) if trial.nail in plan.nails else ()
    paper = Path(plan.paper_weights) if trial.arm is Variant.PAPER else None
    spec = JobSpec(_source(plan, trial, errors, setup), trial.arm, paper, nails, plan.device)
    options = {
        "--seed": None if plan.on_robot else trial.seed,
        "--variant": None if trial.arm is Variant.FULL else trial.arm,
        "--paper-weights": paper,
        "--errors": None if errors == "nominal" else errors,
        "--sensor": trial.sensor,
        "--setup": setup,
        "--nail": trial.nail if nails else None,
        "--device": None if plan.device == "cpu" else plan.device,
    }
    given = {name: value for name, value in options.items() if value is not None}
    words = [word for name, value in given.items() for word in (name, str(value))]
    return Task(trial, spec, (*_command(plan.where), *words), out_of(trial, folder))


def _command(where: Where) -> tuple[str, ...]:
    """The command of a plan's jobs, with what is the same in all of them."""
    match where:
        case InSimulation(config, robot):
            own = ("--config", config) if config else ()
            return ("sim", "hammer", *own, *(("--robot", robot) if robot else ()))
        case InRehearsal(station, factor, profile):
            slow = () if factor is None else ("--real-time-factor", f"{factor:g}")
            return ("rehearse", "hammer", station, *slow, *(() if profile == "harsh" else ("--profile", profile)))
        case OnRobot(station):
            return ("run", "hammer", station)


def _source(plan: TrialPlan, trial: Trial, errors: str, setup: Path | None) -> Source:
    from toolee_robot.app.simulated import Rehearsal, Simulated, cell_errors
    from toolee_robot.app.sources import Lab

    config = station_of(plan.where, setup)
    match plan.where:
        case InSimulation():
            return Simulated(config, trial.seed, errors=cell_errors(errors), sensor=trial.sensor)
        case InRehearsal(station, factor, profile):
            return Rehearsal(config, Path(station), trial.seed, factor, profile)
        case OnRobot(station):
            return Lab(config, Path(station))


@cache
def station_of(where: Where, setup: Path | None) -> StationConfig:
    """What the jobs of a plan are told of the station.

    Args:
        where: Where they are done.
        setup: What is set up for one of them; None for what the station has.

    Returns:
        The station.

    Raises:
        ConfigError: A file cannot be read, or a field is wrong or missing.
    """
    from toolee_robot.app.simulated import simulated_station
    from toolee_robot.app.sources import lab_station

    match where:
        case InSimulation(config, robot):
            model = None if robot is None else ArmModel(robot)
            return simulated_station(Path(config) if config else None, setup, model)
        case InRehearsal(station) | OnRobot(station):
            return lab_station(Path(station), setup)


def out_of(trial: Trial, folder: Path) -> Path:
    """Where the folder of a trial's job lies: jobs of one seed that begin in the same second need folders of their own.

    Args:
        trial: The trial.
        folder: The trials' folder.

    Returns:
        The parent of the job's folder.
    """
    return folder / RUNS / trial.arm / slug(trial.conditions.replace(", ", "-"))


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
    figures, tries = job(task.spec, task.out), 1
    while figures.get("machine_stalled") and tries < TRIES:
        figures, tries = job(task.spec, task.out), tries + 1
    return Record(task.trial, {**figures, "tries": tries}, task.command)


def check_paper_weights(plan: TrialPlan, done: Iterable[Record]) -> None:
    """Read the weights that the arm `paper` needs, before the first job.

    Args:
        plan: The plan.
        done: The results that there are.

    Raises:
        AssetError: The weights are missing or unreadable.
        UserError: They are for clouds of whole tools (`user.paper_column`), or others than those of the results.
    """
    if not plan.paper_weights:
        return
    # Networks take seconds to import, which no other plan needs here.
    from toolee_robot.perception.pose.tooleenet import PaperEstimator
    from toolee_robot.perception.weight_files import weights_hash

    folder = Path(plan.paper_weights)
    PaperEstimator.load_for_job(folder)
    now = weights_hash(folder)
    before = {record.figures.get("paper_weights") for record in done if record.trial.arm is Variant.PAPER} - {now}
    if before:
        raise UserError(
            f"{folder} holds other weights ({now[:12]}) than the finished trials used "
            f"({', '.join(str(one)[:12] for one in before)}): restore those, or give another --out"
        )


def _written(file: Path, content: Mapping[str, Any]) -> Path:
    if not file.is_file():
        file.parent.mkdir(exist_ok=True)
        write_atomic(file, yaml.safe_dump(dict(content)).encode())
    return file
