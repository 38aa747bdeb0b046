"""Run the jobs of a plan, each in a process of its own, and keep every result as soon as there is one.

A job that crashes ends no other. A run that was killed goes on where it stopped when it is started again. Jobs are
forked from a server that has imported everything they need: the imports are a fifth of a job's time. Each computes in
one thread: as many jobs as cores run side by side, and how many must not change what they compute.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass
from functools import cache, partial
from itertools import islice
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any, TypeVar

import yaml

from toolee_robot.app.variant import Variant
from toolee_robot.errors import TooleeError, UserError
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.processes import ONE_THREAD, environment, interrupts_blocked, raise_interrupts
from toolee_robot.station import StationConfig
from toolee_robot.trials.plan import InRehearsal, InSimulation, OnRobot, Trial, TrialPlan, Where, slug
from toolee_robot.trials.results import Happened, Record, Results
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
            own = ("--station", config) if config else ()
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


PRELOADED = [
    "toolee_robot.app.job",
    "toolee_robot.app.simulated",
    "toolee_robot.stations.simulated",
    "toolee_robot.perception.pipeline",
]
"""Modules that import what a job needs."""
_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(PRELOADED)
_running: set[BaseProcess] = set()
_starting = Lock()
_stopping = Event()


def run_apart(spec: JobSpec, out: Path) -> dict[str, Any]:
    """Do a job in a process of its own. It ends when this process does, for whatever reason.

    Args:
        spec: The job.
        out: Parent of the job's folder.

    Returns:
        Its figures.

    Raises:
        TooleeError: It did not come to an end of its own; code `trials.crashed`.
    """
    with tempfile.TemporaryDirectory() as scratch:
        said = Path(scratch) / "said"
        figures, told = _CONTEXT.Pipe(duplex=False)
        process = _CONTEXT.Process(target=_do, args=(Path.cwd(), spec, out, told, said))
        # The first start begins the server: all jobs get its environment, and a terminal's Ctrl-C must not meet it.
        with _starting, environment(ONE_THREAD), interrupts_blocked():
            process.start()
        told.close()  # so that the pipe ends with the job
        _running.add(process)
        if _stopping.is_set():  # while it was started
            process.terminate()
        try:
            answer = figures.recv()
        except EOFError:
            answer = None
        finally:
            process.join()
            _running.discard(process)
            figures.close()
        if isinstance(answer, dict):
            return answer
        words = said.read_text(errors="replace").strip()[-500:] if said.is_file() else "it did not begin"
        reason = answer or f"the job ended with code {process.exitcode}: {words}"
        raise TooleeError(reason, code="trials.crashed")


def stop_jobs() -> None:
    """Tell every job of `run_apart` that still runs to stop its arm and end."""
    _stopping.set()
    for process in tuple(_running):
        process.terminate()


def _do(folder: Path, spec: JobSpec, out: Path, told: Connection, said: Path) -> None:
    from toolee_robot.app.job import run_job

    Thread(target=_end_with_parent, daemon=True).start()
    with said.open("wb") as file:
        for stream in (sys.stdout, sys.stderr):
            os.dup2(file.fileno(), stream.fileno())
    os.chdir(folder)
    raise_interrupts()  # SIGTERM stops the arm, as Ctrl-C does
    try:
        job = run_job(spec, out)
    except TooleeError as error:
        told.send(str(error))
    else:
        if not job.interrupted:
            told.send(job.figures)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait_for([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)  # stops the arm, and whatever the job has started


MOST_CRASHES = 3
"""Least number of jobs one after the other that crash, none ending between them, after which a plan is given up; where
more run side by side, as many as do: jobs that crash at their start overtake those that will not."""

T = TypeVar("T")
R = TypeVar("R")


def run_trials(
    plan: TrialPlan,
    folder: Path,
    jobs: int | None = 1,
    tell: Callable[[str], object] = print,
    job: Job = run_apart,
) -> list[Record]:
    """Run the trials of a plan that its folder does not have yet.

    Args:
        plan: The plan.
        folder: Its folder; made where there is none.
        jobs: Number of jobs side by side; None for one per core.
        tell: Told of each finished job.
        job: Does a job.

    Returns:
        All results, in the plan's order.

    Raises:
        UserError: The folder holds another plan's trials, or a person is led through this one's;
            or as of `check_paper_weights`.
        AssetError: As of `check_paper_weights`.
        ConfigError: A file that the plan names cannot be read, or a field is wrong or missing.
        TooleeError: Jobs did not come to an end of their own; code `trials.crashed`. The others are done before it is
            raised, unless so many crash one after the other (`MOST_CRASHES`) that the plan is given up.
    """
    if plan.led:
        raise UserError("a person is led through this plan's trials: `lead_trials`")
    with Results(plan, folder) as results:
        check_paper_weights(plan, results.records)
        todo = [task_of(plan, trial, folder) for trial in plan.order() if trial not in results.done]
        if results.done:
            tell(f"{len(results.done)} of {len(results.done) + len(todo)} trials are already done")
        crashed: list[_Crash] = []
        with closing(on_threads(partial(_run, job), todo, jobs)) as finished:
            in_a_row, most = 0, max(MOST_CRASHES, jobs or cores())
            for ended in finished:
                if isinstance(ended, Record):
                    in_a_row = 0
                    results.add(ended)
                    tell(told(ended))
                    continue
                in_a_row += 1
                crashed.append(ended)
                results.note(Happened.NOT_BEGUN, ended.trial, reason=ended.reason)
                tell(f"{_name(ended.trial)}: crashed: {ended.reason}")
                if in_a_row == most:
                    break
        if crashed:
            left = len(plan.order()) - len(results.done)
            raise TooleeError(
                f"{len(crashed)} {'job' if len(crashed) == 1 else 'jobs'} crashed, and {left} of the trials are not "
                f"done. Fix the cause; the same command tries them again. The last one: {crashed[-1].reason}",
                code="trials.crashed",
            )
        return results.records


@dataclass(frozen=True)
class _Crash:
    """A job that did not come to an end of its own.

    Attributes:
        trial: Its trial.
        reason: What it said last.
    """

    trial: Trial
    reason: str


def _run(job: Job, task: Task) -> Record | _Crash:
    """Run a trial's job; one that crashes must not end the others."""
    try:
        return run_task(job, task)
    except TooleeError as error:
        if error.code != "trials.crashed":
            raise
        return _Crash(task.trial, str(error))


def on_threads(call: Callable[[T], R], items: Sequence[T], count: int | None) -> Generator[R]:
    """Call a function for every item, in threads of this process.

    Args:
        call: The function.
        items: The items.
        count: Largest number of calls at a time; None for one per core.

    Yields:
        The results, in the order in which they are finished; those that are, before an error of another call.
    """
    left, most = iter(items), count or cores()
    _stopping.clear()
    with ThreadPoolExecutor(most) as pool:
        waiting: set[Future[R]] = set()
        try:
            while True:
                waiting |= {pool.submit(call, item) for item in islice(left, most - len(waiting))}
                if not waiting:
                    return
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in sorted(done, key=lambda future: future.exception() is not None):
                    yield future.result()
        except (KeyboardInterrupt, GeneratorExit):  # else the pool would wait until the jobs have ended by themselves
            stop_jobs()
            raise
        finally:
            for future in waiting:
                future.cancel()


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def told(record: Record) -> str:
    """A result in a line.

    Args:
        record: The result.

    Returns:
        Arm, seed, what differs, and how it ended.
    """
    figures = record.figures
    ending = "flush" if record.success else f"failed: {figures['reason']}"
    tries = "" if figures["tries"] == 1 else f", try {figures['tries']}: the machine had stalled"
    return f"{_name(record.trial)}: {ending}{tries}"


def _name(trial: Trial) -> str:
    return f"{trial.arm}, seed {trial.seed}" + (f", {trial.conditions}" if trial.conditions else "")
