"""A job in a process of its own, forked from a server that has imported everything a job needs.

The imports are a fifth of a simulated job's time. A job that crashes takes nobody with it.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from toolee_robot.errors import TooleeError

PRELOADED = "toolee_robot.cli.hammering.job"
"""Module that imports what a job needs."""
_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload([PRELOADED])


def run_job(options: Sequence[str]) -> dict[str, Any]:
    """Run `toolee hammer`.

    Args:
        options: Its options, `--json` among them.

    Returns:
        What it printed.

    Raises:
        TooleeError: It did not come to an end of its own; code `trials.crashed`.
    """
    with tempfile.TemporaryDirectory() as folder:
        told, said = Path(folder) / "stdout", Path(folder) / "stderr"
        process = _CONTEXT.Process(target=_hammer, args=(tuple(options), told, said))
        process.start()
        process.join()
        lines = told.read_text().splitlines() if told.is_file() else []
        if process.exitcode not in (0, 1) or not lines:
            reason = said.read_text().strip()[-500:] if said.is_file() else "it did not begin"
            raise TooleeError(
                f"toolee hammer {' '.join(options)} ended with code {process.exitcode}: {reason}",
                code="trials.crashed",
            )
        return dict(json.loads(lines[-1]))


def _hammer(options: tuple[str, ...], told: Path, said: Path) -> None:
    for path, stream in ((told, sys.stdout), (said, sys.stderr)):
        with path.open("wb") as file:
            os.dup2(file.fileno(), stream.fileno())
    # The command line is above this package: by name only.
    code = import_module("toolee_robot.cli.app").run(["hammer", *options])
    sys.stdout.flush()
    raise SystemExit(code)
