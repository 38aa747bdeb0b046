"""`toolee replay` and `toolee runs`: what lies in `runs/`, and a look at one of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import track
from rich.table import Table

from toolee_robot.cli.output import JsonOption, serve

if TYPE_CHECKING:
    from toolee_robot.recording.history import RunHistory
    from toolee_robot.station import StationConfig


@dataclass(frozen=True)
class Replay:
    """Show a run in the browser: what the robot did, saw, estimated and decided.

    Example: toolee replay runs/20261124-101500-seed100

    Example: toolee replay runs/20261124-101500-seed100 --gif run.gif

    Needs the extra viewer.
    """

    recording: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RUN")]]
    """The run's folder, or its recording.mcap. A killed run is readable up to its last written second."""
    port: Annotated[int, tyro.conf.arg(metavar="N")] = 8080
    """Port of the page, or the next free one."""
    gif: Annotated[Path | None, tyro.conf.arg(metavar="GIF", help_behavior_hint="")] = None
    """Write the run as a GIF of ten seconds, and open no page."""
    finish: Annotated[Path | None, tyro.conf.arg(metavar="MCAP", help_behavior_hint="")] = None
    """Copy a killed run's recording into a new, complete file, and open no page."""

    def run(self) -> int:
        from toolee_robot.recording.reading import finish_copy, read_history, recording_of

        console = Console(highlight=False)
        path = recording_of(self.recording)
        if self.finish is not None:
            count = finish_copy(path, self.finish)
            console.print(f"{count} messages in {escape(str(self.finish))}")
            return 0
        history = read_history(path)
        if history.damage:
            console.print(f"[yellow]The recording: {escape(history.damage)}.[/yellow]", soft_wrap=True)
        config = history.station()
        if self.gif is not None:
            _write_gif(self.gif, history, config, console)
            return 0
        self._show(history, config, console)
        return 0

    def _show(self, history: RunHistory, config: StationConfig, console: Console) -> None:
        from toolee_robot.viewer.rerun_page import RerunPage
        from toolee_robot.viewer.run_view import RunView, blueprint

        with console.status("building the page"):
            page = RerunPage("replay", blueprint(), self.port)
            RunView(page.stream, history, config).update()
        console.print(escape(history.metadata.get("title", "")))
        serve(page, console)


@dataclass(frozen=True)
class Runs(JsonOption):
    """List the runs in a folder: date, station and seed, outcome, strikes, duration, size.

    Example: toolee runs

    A run without an outcome is still running, or was killed. `toolee replay` shows it up to its last written second.
    --json prints a list, the oldest run first.
    """

    folder: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="DIR")]] = Path("runs")
    """The folder that a job's --out names."""

    def run(self) -> int:
        from toolee_robot.recording.reading import list_runs

        runs = list_runs(self.folder)
        self.tell(runs)
        if self.json:
            return 0
        console = self.console
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


COMMANDS = {"replay": Replay, "runs": Runs}


def _write_gif(path: Path, history: RunHistory, config: StationConfig, console: Console) -> None:
    from toolee_robot.viewer.gif import pictures, write_gif

    count, drawn = pictures(history, config)
    write_gif(path, track(drawn, "drawing", count, console=console, transient=True))
    console.print(f"GIF: {escape(str(path))}")


def _row(run: dict[str, Any]) -> tuple[str, ...]:
    colour = {True: "green", False: "red", None: "yellow"}[run["success"]]
    return (
        Path(run["folder"]).name,
        run["source"] if run["seed"] is None else f"{run['source']} {run['seed']}",
        f"[{colour}]{run['outcome'].replace('_', ' ')}[/{colour}]",
        "" if run["strikes"] is None else str(run["strikes"]),
        "" if run["robot_seconds"] is None else f"{run['robot_seconds']:.0f} s",
        f"{run['megabytes']:.1f}",
    )
