"""The command line, `toolee`; the only layer that knows whether a station is simulated."""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Sequence
from functools import partial
from types import FrameType
from typing import Any

from toolee_robot.runtime.processes import SIGNALS, raise_interrupts, restore_interrupts

EXIT_INTERRUPTED = 130
INTERRUPTED_LINE = '{"error": {"code": "interrupted", "message": "interrupted before there was a result"}}\n'
"""What --json prints then."""


def main(args: Sequence[str] | None = None) -> None:
    """Run `toolee` and exit with the command's exit code.

    Until the command starts, nothing moves, and an interrupt ends the process at once: whatever was being imported.

    Args:
        args: The arguments; None for those of the process.
    """
    for number in SIGNALS:
        if signal.getsignal(number) in (signal.default_int_handler, signal.SIG_DFL):
            signal.signal(number, partial(_leave, "--json" in (sys.argv if args is None else args)))
    _let_threads_sleep()
    output = _patient_output()
    from toolee_robot.cli.app import EXIT_FAILED, run

    try:
        code = run(args, start=raise_interrupts)
        sys.stdout.flush()
        if output is not None and output.failure is not None:
            code = code or EXIT_FAILED
            if not isinstance(output.failure, BrokenPipeError):  # of `| head` nothing is said
                print(f"error: part of the output is lost: {output.failure.strerror}", file=sys.stderr)
    finally:
        restore_interrupts()
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


def _leave(as_json: bool, _signum: int, _frame: FrameType | None) -> None:
    os.write(2, b"Interrupted.\n")
    if as_json:
        os.write(1, INTERRUPTED_LINE.encode())
    os._exit(EXIT_INTERRUPTED)


def _let_threads_sleep() -> None:
    """Let torch's waiting threads spin for some tens of microseconds, then sleep, unless the environment is set.

    Medians for a pose on 2 cores of a virtual machine: 26 ms with this setting, 52 ms with a tenth of the spins, 21 ms
    with endless spinning; beside a program that keeps one core busy 77, 40 and 225 ms. OpenMP reads the setting once,
    when torch is first imported, which no module of the command line does before its command runs.
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
        os.environ.setdefault("GOMP_SPINCOUNT", "10000")
