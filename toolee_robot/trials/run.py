"""Run the jobs of a plan, each in a process of its own, and keep every result as soon as there is one.

A run that was killed goes on where it stopped when it is started again.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Protocol, TypeVar

from toolee_robot.errors import UserError
from toolee_robot.trials.plan import TrialPlan
from toolee_robot.trials.process import run_job, stop_jobs
from toolee_robot.trials.results import Record, Results
from toolee_robot.trials.tasks import Job, check_paper_weights, run_task, task_of

T = TypeVar("T")
R = TypeVar("R")


class Workers(Protocol):
    """Where jobs run: `on_threads` on this machine, `on_ray` on a cluster."""

    def __call__(self, call: Callable[[T], R], items: Sequence[T], count: int | None, /) -> Generator[R]:
        """Call a function for every item.

        Args:
            call: The function.
            items: The items.
            count: Largest number of calls at a time; None for one per core.

        Yields:
            The results, in the order in which they are finished.
        """


def run_trials(
    plan: TrialPlan,
    folder: Path,
    jobs: int | None = 1,
    tell: Callable[[str], object] = print,
    job: Job | None = None,
    workers: Workers | None = None,
) -> list[Record]:
    """Run the trials of a plan that its folder does not have yet.

    Args:
        plan: The plan.
        folder: Its folder; made where there is none.
        jobs: Number of jobs side by side; None for one per core.
        tell: Told of each finished job.
        job: Runs a job; None for `toolee hammer` in a process of its own, in this working directory.
        workers: Where; None for this machine.

    Returns:
        All results, in the plan's order.

    Raises:
        UserError: The folder holds another plan's trials (`user.other_plan`), or a person is led through this one's
            (`user.attended`); or as of `check_paper_weights`.
        AssetError: As of `check_paper_weights`.
        TooleeError: A job did not come to an end of its own; code `trials.crashed`. Finished ones are kept.
    """
    if plan.led:
        raise UserError("a person is led through this plan's trials: `lead_trials`", code="user.attended")
    with Results(plan, folder) as results:
        check_paper_weights(plan, results.records)
        todo = [task_of(plan, trial, folder) for trial in plan.order() if trial not in results.done]
        if results.done:
            tell(f"{len(results.done)} of {len(results.done) + len(todo)} trials are there already")
        run = partial(run_task, job or partial(run_job, Path.cwd()))
        with closing((workers or on_threads)(run, todo, jobs)) as finished:
            for record in finished:
                results.add(record)
                tell(told(record))
        return results.records


def on_threads(call: Callable[[T], R], items: Sequence[T], count: int | None) -> Generator[R]:
    """Call a function for every item, in threads of this process.

    Args:
        call: The function.
        items: The items.
        count: Largest number of calls at a time; None for one per core.

    Yields:
        The results, in the order in which they are finished; those that are, before an error of another call.
    """
    left, most = iter(items), count or len(os.sched_getaffinity(0))
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


def told(record: Record) -> str:
    """A result in a line.

    Args:
        record: The result.

    Returns:
        Arm, seed, what differs, and how it ended.
    """
    figures, trial = record.figures, record.trial
    ending = "flush" if record.success else f"failed: {figures['reason']}"
    tries = "" if figures["tries"] == 1 else f", try {figures['tries']}: the machine had stalled"
    conditions = f", {trial.conditions}" if trial.conditions else ""
    return f"{trial.arm}, seed {trial.seed}{conditions}: {ending}{tries}"
