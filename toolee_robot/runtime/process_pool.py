"""A process pool that neither outlives nor blocks the process that started it."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing.connection import wait
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"), "1"
)
"""Environment of workers: without it, Embree, BLAS, torch and OpenCV start one thread per core in each of them."""


@contextlib.contextmanager
def environment(variables: dict[str, str]) -> Iterator[None]:
    """Context in which processes are started with further environment variables.

    Args:
        variables: Their names and values.
    """
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


class WorkerPool(ProcessPoolExecutor):
    """A pool of spawned processes.

    They are spawned because a fork would inherit the threads of torch and embree in an undefined state. They end when
    the parent process ends, for whatever reason, and do not receive Ctrl-C; when an exception leaves the pool's
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
        # A worker that Ctrl-C interrupts while it holds a queue's lock would block the pool.
        with _ctrl_c_blocked():  # a process inherits the signal mask
            return super().submit(function, *args, **kwargs)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Wait for the running calls; after an exception kill the processes instead, so that nothing blocks."""
        if kind is None:
            self.shutdown(cancel_futures=True)
            return
        with _ctrl_c_blocked():
            for worker in list((self._processes or {}).values()):  # kill_workers() of Python 3.14
                worker.kill()
            self.shutdown(cancel_futures=True)


@contextlib.contextmanager
def _ctrl_c_blocked() -> Iterator[None]:
    """Context in which Ctrl-C is deferred to its end."""
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
