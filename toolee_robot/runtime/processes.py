"""Processes: which code they run, the environment of those that are started, and how they are interrupted.

Ctrl-C, SIGTERM and SIGHUP all end a command in the same order, as a KeyboardInterrupt.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import toolee_robot

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""The interrupts; one that the process ignores, as under nohup, stays ignored."""
SAME_WISH_S = 1.0
"""Time after an interrupt in which others are not heard [s]: a second one would break what the first one cleans up."""

_heard = -SAME_WISH_S
"""When the last one was raised, on the monotonic clock [s]."""


def raise_interrupts() -> None:
    """Let each interrupt of this process raise KeyboardInterrupt in its main thread, which calls this."""
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    sys.unraisablehook = _unraisable


def restore_interrupts() -> None:
    """Let them do again what they do in any Python program."""
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler if number is signal.SIGINT else signal.SIG_DFL)


@contextmanager
def interrupts_held(*, forget: bool = False) -> Iterator[None]:
    """Context that no interrupt leaves: a step that must not be done by half.

    Args:
        forget: Whether one that comes meanwhile is forgotten; otherwise it is raised at the end.
    """
    if threading.current_thread() is not threading.main_thread():  # only that one is interrupted
        yield
        return
    came: list[int] = []
    before = {number: signal.getsignal(number) for number in SIGNALS}
    raising = [number for number, handler in before.items() if callable(handler)]
    for number in raising:
        signal.signal(number, lambda signum, _: came.append(signum))
    try:
        yield
    finally:
        for number in raising:
            signal.signal(number, before[number])
        if came and not forget:
            signal.raise_signal(came[0])


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Context in which interrupts are deferred to its end; a process that is started in it never gets one."""
    from multiprocessing.resource_tracker import ensure_running

    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        with interrupts_held():  # one that another thread receives
            ensure_running()  # what the first process starts, too; it unblocks two of them
            signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
            yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _interrupt(signum: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, but after an import that is going on: libraries swallow it there, or break."""
    global _heard
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            _interrupt_again(signum)
            return
        frame = frame.f_back
    if time.monotonic() - _heard < SAME_WISH_S:
        return
    _heard = time.monotonic()
    raise KeyboardInterrupt


def _interrupt_again(signum: int = signal.SIGINT) -> None:
    again = threading.Timer(0.05, os.kill, (os.getpid(), signum))
    again.daemon = True
    again.start()


def _unraisable(ignored: sys.UnraisableHookArgs) -> None:
    """An interrupt that came in a callback, from which nothing can be raised, comes again."""
    global _heard
    if issubclass(ignored.exc_type, KeyboardInterrupt):
        _heard = -SAME_WISH_S
        _interrupt_again()
    else:
        sys.__unraisablehook__(ignored)


def code_version() -> str:
    """The package's version and, from a git checkout, its commit.

    Returns:
        Such as "0.2.0" or "0.2.0 a1b2c3d4e5f6", with "-dirty" appended where tracked files differ from the commit.
    """
    version = toolee_robot.__version__
    folder = Path(toolee_robot.__file__).parent
    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=12", "--match="]
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=10.0, check=True)
    except (OSError, subprocess.SubprocessError):
        return version
    return f"{version} {found.stdout.strip()}"


ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"), "1"
)
"""Environment of workers: without it, Embree, BLAS, torch and OpenCV start one thread per core in each of them."""


@contextmanager
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
