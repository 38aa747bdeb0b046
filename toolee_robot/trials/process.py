"""A job in a process of its own. One that crashes takes nobody with it.

A simulated one is forked from a server that has imported everything a job needs: the imports are a fifth of its time.
It computes in one thread: as many jobs as cores run side by side, and how many must not change what they compute.
One at which a person stands has the terminal.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Lock, Thread
from typing import Any

from toolee_robot.errors import TooleeError
from toolee_robot.runtime.process_pool import ONE_THREAD, environment

PRELOADED = "toolee_robot.cli.hammering.job"
"""Module that imports what a job needs."""
_COMMAND = "from toolee_robot.cli import main; main()"
_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload([PRELOADED])
_running: set[BaseProcess] = set()
_starting = Lock()


def run_job(folder: Path, options: Sequence[str]) -> dict[str, Any]:
    """Run `toolee hammer`. It ends when this process does, for whatever reason.

    Args:
        folder: Its working directory.
        options: Its options, `--json` among them.

    Returns:
        What it printed.

    Raises:
        TooleeError: It did not come to an end of its own; code `trials.crashed`.
    """
    with tempfile.TemporaryDirectory() as scratch:
        told, said = Path(scratch) / "stdout", Path(scratch) / "stderr"
        process = _CONTEXT.Process(target=_hammer, args=(folder, tuple(options), told, said))
        with _starting, environment(ONE_THREAD):  # the first start begins the server, whose environment all jobs get
            process.start()
        _running.add(process)
        try:
            process.join()
        finally:
            _running.discard(process)
        lines = told.read_text().splitlines() if process.exitcode in (0, 1, 2) and told.is_file() else []
        reason = said.read_text().strip()[-500:] if said.is_file() else "it did not begin"
        return _figures(lines, f"toolee hammer {shlex.join(options)} ended with code {process.exitcode}: {reason}")


def stop_jobs() -> None:
    """Tell every job of `run_job` that still runs to stop its arm and end."""
    for process in tuple(_running):
        process.terminate()


def run_at_terminal(options: Sequence[str]) -> dict[str, Any]:
    """Run `toolee hammer` at the terminal of this process: it prompts and asks there.

    Ctrl-C and SIGTERM stop the arm; the job then ends by itself, and this process goes on.

    Args:
        options: Its options, `--json` among them.

    Returns:
        What it printed on standard output.

    Raises:
        TooleeError: It could not begin, or did not come to an end of its own; code `trials.crashed`.
    """
    with _left_to_the_job() as job:
        job.append(subprocess.Popen([sys.executable, "-c", _COMMAND, "hammer", *options], stdout=subprocess.PIPE))
        said, _ = job[0].communicate()
    return _figures(said.decode().splitlines(), f"it ended with code {job[0].returncode}, see above")


def _figures(printed: list[str], ended: str) -> dict[str, Any]:
    """The figures that a job printed; one that was refused before it began, or did not come to its end, has none."""
    figures = dict(json.loads(printed[-1])) if printed else {}
    if "stage_seconds" not in figures:
        raise TooleeError(str(figures.get("error", {}).get("message", ended)), code="trials.crashed")
    return figures


@contextmanager
def _left_to_the_job() -> Iterator[list[subprocess.Popen[bytes]]]:
    """Context in which a child gets the signals that would end this process: a job must stop its arm itself."""
    job: list[subprocess.Popen[bytes]] = []

    def terminate(*_: object) -> None:
        for process in job:
            process.terminate()

    # Handlers, other than SIG_IGN, do not outlive the start of the child. The terminal sends it Ctrl-C, too.
    before = {
        signal.SIGINT: signal.signal(signal.SIGINT, lambda *_: None),
        signal.SIGTERM: signal.signal(signal.SIGTERM, terminate),
    }
    try:
        yield job
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _hammer(folder: Path, options: tuple[str, ...], told: Path, said: Path) -> None:
    Thread(target=_end_with_parent, daemon=True).start()
    for path, stream in ((told, sys.stdout), (said, sys.stderr)):
        with path.open("wb") as file:
            os.dup2(file.fileno(), stream.fileno())
    os.chdir(folder)
    # The command line is above this package: by name only.
    code = import_module("toolee_robot.cli.app").run(["hammer", *options])
    sys.stdout.flush()
    raise SystemExit(code)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)  # stops the arm, and whatever the job has started
