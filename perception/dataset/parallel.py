"""One call for each scene, on several processes, each pinned to a core."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from toolee_robot.errors import TooleeError
from toolee_robot.perception.dataset.spec import SceneJob
from toolee_robot.runtime.process_pool import WorkerPool

T = TypeVar("T")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Embree and BLAS would each start a thread per core, and the workers fight over them."""


def on_processes(make: Callable[[SceneJob], T], jobs: list[SceneJob], workers: int) -> Generator[T]:
    """make(job) for every job on so many processes, as they are done.

    Processes of their own, even a single one: it computes with one thread whatever this one was started with."""
    if not jobs:
        return
    cores = multiprocessing.get_context("spawn").Queue()
    for k in range(workers):
        cores.put(k)
    with _environment(ONE_THREAD), WorkerPool(min(workers, len(jobs)), _prepare, (cores,)) as pool:
        futures = {pool.submit(make, job) for job in jobs}
        try:
            for future in as_completed(futures):
                futures.discard(future)
                yield future.result()
        except BrokenProcessPool as error:
            raise TooleeError(
                "a worker process died (out of memory?): run the same command again, with fewer --workers; it resumes"
            ) from error


@contextlib.contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """These environment variables, for the processes started inside."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name)
            else:
                os.environ[name] = value


def _prepare(cores: multiprocessing.Queue[int]) -> None:
    """Pin this worker to a core."""
    number = cores.get()
    if hasattr(os, "sched_setaffinity"):
        own = sorted(os.sched_getaffinity(0))
        with contextlib.suppress(OSError):  # some containers forbid it: then the workers are only slower
            os.sched_setaffinity(0, {own[number % len(own)]})
