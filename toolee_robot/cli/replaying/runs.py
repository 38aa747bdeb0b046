"""`toolee runs`: what lies in `runs/`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from toolee_robot.cli.options import Flag
from toolee_robot.cli.replaying.run_list import Run, list_runs
from toolee_robot.runtime.json_line import json_line


@dataclass(frozen=True)
class Runs:
    """List the runs in a folder: date, station and seed, outcome, strikes, duration, size.

    Example: toolee runs

    A run without an outcome goes on, or was killed; `toolee replay` shows it up to its last written second.
    """

    folder: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="DIR")]] = Path("runs")
    """The folder: what `--out` of a job names."""
    json: Flag = False
    """Print one line of JSON on standard output: a list, the oldest run first."""

    def run(self) -> int:
        runs = list_runs(self.folder)
        if self.json:
            print(json_line([asdict(run) | {"folder": str(run.folder), "date": run.date.isoformat()} for run in runs]))
            return 0
        console = Console(highlight=False)
        if not runs:
            console.print(f"no runs in {self.folder}")
            return 0
        table = Table(box=None, pad_edge=False)
        for name, right in (("run", 0), ("source", 0), ("outcome", 0), ("strikes", 1), ("robot", 1), ("MB", 1)):
            table.add_column(name, justify="right" if right else "left", no_wrap=True)
        for run in runs:
            table.add_row(*_row(run))
        console.print(table)
        return 0


def _row(run: Run) -> tuple[str, ...]:
    colour = {True: "green", False: "red", None: "yellow"}[run.success]
    source = run.source if run.seed is None else f"{run.source} {run.seed}"
    return (
        run.folder.name,
        source,
        f"[{colour}]{run.outcome.replace('_', ' ')}[/{colour}]",
        "" if run.strikes is None else str(run.strikes),
        "" if run.robot_seconds is None else f"{run.robot_seconds:.0f} s",
        f"{run.megabytes:.1f}",
    )


COMMANDS = {"": Runs}
