"""Parallel map over processes with a state each."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from typing import Any, Generic, Self, TypeVar

import cv2
import torch

from toolee_robot.errors import TooleeError, UserError
from toolee_robot.runtime.process_pool import WorkerPool

State = TypeVar("State")
Item = TypeVar("Item")
Result = TypeVar("Result")


class ProcessMap(Generic[State]):
    """Maps functions over items in several processes, each with a state of its own.

    Args:
        begin: Makes the state of a process; picklable.
        workers: Number of processes; with one, the calling process does the work.

    Raises:
        UserError: `workers` is less than 1.
    """

    def __init__(self, begin: Callable[[], State], workers: int) -> None:
        if workers < 1:
            raise UserError(f"--workers {workers}: give 1 or more", code="user.workers")
        self._begin, self._workers = begin, workers
        self._own: list[State] = []
        self._pool: WorkerPool | None = None
        if workers > 1:
            self._pool = WorkerPool(workers, _begin, (begin,))

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


def _begin(begin: Callable[[], Any]) -> None:
    # One core each: threads of every process for every core of a large machine leave none of them any.
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    _state.append(begin())


def _call(function: Callable[[Any, Any], Any], item: Any) -> Any:
    return function(_state[0], item)
