"""Processes that share work: a pool that neither outlives nor blocks its parent, and a map over processes."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from multiprocessing.connection import wait
from typing import Any, Generic, ParamSpec, Self, TypeVar

import cv2

from toolee_robot.errors import TooleeError, UserError
from toolee_robot.runtime.processes import ONE_THREAD, environment, interrupts_blocked

P = ParamSpec("P")
T = TypeVar("T")
State = TypeVar("State")
Item = TypeVar("Item")
Result = TypeVar("Result")


MOST_WORKERS = 1024
"""More processes than any machine here has cores."""


def check_workers(workers: int) -> None:
    """Raises UserError for a number of processes that cannot be started."""
    if not 1 <= workers <= MOST_WORKERS:
        raise UserError(f"--workers {workers}: give 1 to {MOST_WORKERS}", code="user.workers")


class WorkerPool(ProcessPoolExecutor):
    """A pool of spawned processes.

    They are spawned because a fork would inherit the threads of torch and embree in an undefined state. They end when
    the parent process ends, for whatever reason, and do not receive interrupts; when an exception leaves the pool's
    context, the pool kills them.

    Args:
        workers: Number of processes.
        initializer: Called first in every process; None for none.
        initargs: Arguments of `initializer`.
    """

    def __init__(
        self, workers: int, initializer: Callable[..., object] | None = None, initargs: tuple[object, ...] = ()
    ) -> None:
        super().__init__(workers, multiprocessing.get_context("spawn"), _begin, (initializer, initargs))

    def submit(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Submit a call as ProcessPoolExecutor does; the first call starts the processes.

        Args:
            function: The function; it and its arguments must be picklable.
            *args: Its positional arguments.
            **kwargs: Its keyword arguments.

        Returns:
            The future of the call's result.
        """
        # A worker that is interrupted while it holds a queue's lock would block the pool.
        with interrupts_blocked():  # a process inherits the signal mask
            return super().submit(function, *args, **kwargs)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Wait for the running calls; after an exception kill the processes instead, so that nothing blocks."""
        if kind is None:
            self.shutdown(cancel_futures=True)
            return
        with interrupts_blocked():
            for worker in list((self._processes or {}).values()):  # kill_workers() of Python 3.14
                worker.kill()
            self.shutdown(cancel_futures=True)


def _begin(initializer: Callable[..., object] | None, initargs: tuple[object, ...]) -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    if initializer is not None:
        initializer(*initargs)


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


def on_processes(make: Callable[[Item], Result], jobs: Sequence[Item], workers: int) -> Generator[Result]:
    """Call a function for every job on worker processes, also if there is one: threads are fixed when a process starts.

    Args:
        make: Function of a job; picklable.
        jobs: The jobs.
        workers: Maximum number of processes.

    Yields:
        The results, in order of completion.

    Raises:
        TooleeError: A worker process died.
    """
    if not jobs:
        return
    with environment(ONE_THREAD), WorkerPool(min(workers, len(jobs))) as pool:
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


class ProcessMap(Generic[State]):
    """Maps functions over items in several processes, each with a state of its own.

    Args:
        begin: Makes the state of a process; picklable.
        workers: Number of processes; with one, the calling process does the work.

    Raises:
        UserError: `workers` is less than 1.
    """

    def __init__(self, begin: Callable[[], State], workers: int) -> None:
        check_workers(workers)
        self._begin, self._workers = begin, workers
        self._own: list[State] = []
        self._pool: WorkerPool | None = None
        if workers > 1:
            self._pool = WorkerPool(workers, _begin_state, (begin,))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        if self._pool is not None:
            self._pool.__exit__(*error)

    def map(self, function: Callable[[State, Item], Result], items: Iterable[Item]) -> Generator[Result]:
        """Evaluate function(state, item) for every item, lazily, so that the items may be endless.

        Args:
            function: The function; picklable.
            items: The items; picklable.

        Yields:
            The results in the order of the items.

        Raises:
            TooleeError: A worker process died; otherwise what `function` raises.
        """
        if self._pool is None:
            if not self._own:
                self._own.append(self._begin())
            for item in items:
                yield function(self._own[0], item)
            return
        left = iter(items)
        running: deque[Future[Result]] = deque()
        try:
            while True:
                for item in islice(left, 2 * self._workers - len(running)):
                    running.append(self._pool.submit(_call, function, item))
                if not running:
                    return
                yield running.popleft().result()
        except BrokenProcessPool as error:
            raise TooleeError(
                "a worker process died (out of memory?): run it again with fewer --workers",
                code="toolee.worker_died",
            ) from error
        finally:
            for future in running:
                future.cancel()


_state: list[Any] = []


def _begin_state(begin: Callable[[], Any]) -> None:
    import torch  # here: a process that only renders or decodes images starts in half the time without it

    # One core each: threads of every process for every core of a large machine leave none of them any.
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    _state.append(begin())


def _call(function: Callable[[Any, Any], Any], item: Any) -> Any:
    return function(_state[0], item)
