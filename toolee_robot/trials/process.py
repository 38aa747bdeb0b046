"""A job in a process of its own. One that crashes takes nobody with it.

It is forked from a server that has imported everything a job needs: the imports are a fifth of its time. It computes in
one thread: as many jobs as cores run side by side, and how many must not change what they compute.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any

from toolee_robot.errors import TooleeError
from toolee_robot.runtime.process_environment import ONE_THREAD, environment

if TYPE_CHECKING:
    from toolee_robot.app.job import JobSpec

PRELOADED = ["toolee_robot.app.job", "toolee_robot.app.simulated", "toolee_robot.stations.simulated"]
"""Modules that import what a job needs."""
_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(PRELOADED)
_running: set[BaseProcess] = set()
_starting = Lock()


def run_apart(spec: JobSpec, out: Path) -> dict[str, Any]:
    """Do a job in a process of its own. It ends when this process does, for whatever reason.

    Args:
        spec: The job.
        out: Parent of the job's folder.

    Returns:
        Its figures.

    Raises:
        TooleeError: It did not come to an end of its own; code `trials.crashed`.
    """
    with tempfile.TemporaryDirectory() as scratch:
        said = Path(scratch) / "said"
        figures, told = _CONTEXT.Pipe(duplex=False)
        process = _CONTEXT.Process(target=_do, args=(Path.cwd(), spec, out, told, said))
        with _starting, environment(ONE_THREAD):  # the first start begins the server, whose environment all jobs get
            process.start()
        told.close()  # so that the pipe ends with the job
        _running.add(process)
        try:
            answer = figures.recv()
        except EOFError:
            answer = None
        finally:
            process.join()
            _running.discard(process)
            figures.close()
        if isinstance(answer, dict):
            return answer
        words = said.read_text(errors="replace").strip()[-500:] if said.is_file() else "it did not begin"
        reason = answer or f"the job ended with code {process.exitcode}: {words}"
        raise TooleeError(reason, code="trials.crashed")


def stop_jobs() -> None:
    """Tell every job of `run_apart` that still runs to stop its arm and end."""
    for process in tuple(_running):
        process.terminate()


def _do(folder: Path, spec: JobSpec, out: Path, told: Connection, said: Path) -> None:
    from toolee_robot.app.job import run_job

    Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # it stops the arm, as Ctrl-C does
    with said.open("wb") as file:
        for stream in (sys.stdout, sys.stderr):
            os.dup2(file.fileno(), stream.fileno())
    os.chdir(folder)
    try:
        job = run_job(spec, out)
    except TooleeError as error:
        told.send(str(error))
    else:
        if not job.interrupted:
            told.send(job.figures)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)  # stops the arm, and whatever the job has started
