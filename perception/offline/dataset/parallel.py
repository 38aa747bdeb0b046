"""Parallel execution of scene jobs on local processes, each pinned to a core."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from collections.abc import Callable, Generator
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from toolee_robot.errors import TooleeError
from toolee_robot.perception.offline.dataset.spec import SceneJob
from toolee_robot.perception.offline.processes import WorkerPool
from toolee_robot.runtime.process_environment import ONE_THREAD, environment

T = TypeVar("T")


def on_processes(make: Callable[[SceneJob], T], jobs: list[SceneJob], workers: int) -> Generator[T]:
    """Run make(job) for every job on worker processes.

    A single worker is also a separate process, because the number of threads is fixed when a process starts.

    Args:
        make: Function of a job; it must be picklable.
        jobs: The jobs.
        workers: Maximum number of processes.

    Yields:
        The results, in order of completion.

    Raises:
        TooleeError: A worker process died.
    """
    if not jobs:
        return
    cores = multiprocessing.get_context("spawn").Queue()
    for k in range(workers):
        cores.put(k)
    with environment(ONE_THREAD), WorkerPool(min(workers, len(jobs)), _prepare, (cores,)) as pool:
        futures = {pool.submit(make, job) for job in jobs}
        try:
            for future in as_completed(futures):
                futures.discard(future)
                yield future.result()
        except BrokenProcessPool as error:
            raise TooleeError(
                "a worker process died (out of memory?): run the same command again, with fewer --workers; it resumes",
                code="toolee.worker_died",
            ) from error


def _prepare(cores: multiprocessing.Queue[int]) -> None:
    """Pin this worker process to a core."""
    number = cores.get()
    if hasattr(os, "sched_setaffinity"):
        own = sorted(os.sched_getaffinity(0))
        with contextlib.suppress(OSError):  # forbidden in some containers; affects only speed
            os.sched_setaffinity(0, {own[number % len(own)]})
