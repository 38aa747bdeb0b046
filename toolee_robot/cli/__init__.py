"""The command line, `toolee`; the only layer that knows whether a station is simulated."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
from collections.abc import Sequence
from types import FrameType
from typing import Any

EXIT_INTERRUPTED = 130


def main(args: Sequence[str] | None = None) -> None:
    """Run `toolee` and exit with the command's exit code.

    Until the command starts, nothing moves, and Ctrl-C ends the process at once: whatever was being imported.

    Args:
        args: The arguments; None for those of the process.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)
    _let_threads_sleep()
    output = _patient_output()
    from toolee_robot.cli.app import EXIT_FAILED, run

    try:
        code = run(args, start=_may_move)
        sys.stdout.flush()
        if output is not None and output.failure is not None:
            code = code or EXIT_FAILED
            if not isinstance(output.failure, BrokenPipeError):  # of `| head` nothing is said
                print(f"error: part of the output is lost: {output.failure.strerror}", file=sys.stderr)
    finally:
        if signal.getsignal(signal.SIGINT) in (_leave, _interrupt):
            signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.exit(code)


class _Output(io.FileIO):
    """A file descriptor whose failures end no job: what cannot be written is lost, and `failure` says why."""

    failure: OSError | None = None

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as error:  # a full disk, or the reader of a pipe has gone
            self.failure = error
            return len(data)


def _patient_output() -> _Output | None:
    """Let standard output fail without an error; None where it is closed, or somebody else's."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the shell
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    old = sys.__stdout__
    if old is None or sys.stdout is not old:
        return None
    output = _Output(old.fileno(), "wb", closefd=False)
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(output), encoding=old.encoding, errors=old.errors, line_buffering=old.line_buffering
    )
    return output


def _leave(_signum: int, _frame: FrameType | None) -> None:
    os.write(2, b"Interrupted.\n")
    os._exit(EXIT_INTERRUPTED)


def _may_move() -> None:
    """From here on Ctrl-C is an exception, at which the arm is stopped."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, _interrupt)
        sys.unraisablehook = _unraisable


def _interrupt(signum: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, but after an import that is going on: libraries swallow it there, or break."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            _interrupt_again(signum)
            return
        frame = frame.f_back
    raise KeyboardInterrupt


def _interrupt_again(signum: int = signal.SIGINT) -> None:
    again = threading.Timer(0.05, os.kill, (os.getpid(), signum))
    again.daemon = True
    again.start()


def _unraisable(ignored: sys.UnraisableHookArgs) -> None:
    """An interrupt that came in a callback, from which nothing can be raised, comes again."""
    if issubclass(ignored.exc_type, KeyboardInterrupt):
        _interrupt_again()
    else:
        sys.__unraisablehook__(ignored)


def _let_threads_sleep() -> None:
    """Let torch's waiting threads spin for some tens of microseconds, then sleep, unless the environment is set.

    Medians for a pose on 2 cores of a virtual machine: 26 ms with this setting, 52 ms with a tenth of the spins, 21 ms
    with endless spinning; beside a program that keeps one core busy 77, 40 and 225 ms. OpenMP reads the setting once,
    when torch is first imported, which no module of the command line does before its command runs.
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
        os.environ.setdefault("GOMP_SPINCOUNT", "10000")
