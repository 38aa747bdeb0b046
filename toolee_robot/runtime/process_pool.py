"""Processes that work side by side and never outlive, or hold up, the one that started them."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing.connection import wait
from types import TracebackType
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


class WorkerPool(ProcessPoolExecutor):
    """A pool of `workers` fresh processes; each calls initializer(*initargs) first.

    Fresh, since a fork would inherit the threads of torch and embree in an undefined state. They end at once when this
    process does, however that happened. Ctrl-C is this process's alone: left by an exception, the pool kills them."""

    def __init__(
        self, workers: int, initializer: Callable[..., object] | None = None, initargs: tuple[object, ...] = ()
    ) -> None:
        super().__init__(workers, multiprocessing.get_context("spawn"), _begin, (initializer, initargs))

    def submit(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """As ProcessPoolExecutor's. The first one starts the processes."""
        # A worker that Ctrl-C strikes while it holds a queue's lock brings the pool to a standstill.
        with _ctrl_c_blocked():  # a process inherits what is blocked
            return super().submit(function, *args, **kwargs)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Wait for what has begun; after an exception, for nothing: a second Ctrl-C would find it waiting."""
        if kind is None:
            self.shutdown(cancel_futures=True)
            return
        with _ctrl_c_blocked():
            for worker in list((self._processes or {}).values()):  # kill_workers() of Python 3.14
                worker.kill()
            self.shutdown(cancel_futures=True)


@contextlib.contextmanager
def _ctrl_c_blocked() -> Iterator[None]:
    """What comes meanwhile comes after."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(initializer: Callable[..., object] | None, initargs: tuple[object, ...]) -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    if initializer is not None:
        initializer(*initargs)


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
