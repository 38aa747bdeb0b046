"""`toolee replay`: a look at a recorded run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import track

from toolee_robot.cli.output import serve

if TYPE_CHECKING:
    from toolee_robot.recording.history import RunHistory
    from toolee_robot.station import StationConfig


@dataclass(frozen=True)
class Replay:
    """Show a run in the browser: what the robot did, saw, estimated and decided.

    Example: toolee replay runs/20261124-101500-seed100

    Example: toolee replay runs/20261124-101500-seed100 --gif run.gif

    It needs the extra `viewer`.
    """

    recording: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RUN")]]
    """The run's folder, or its recording.mcap. A killed run is readable up to its last written second."""
    port: Annotated[int, tyro.conf.arg(metavar="N")] = 8080
    """Port of the page, or the next free one."""
    gif: Annotated[Path | None, tyro.conf.arg(metavar="GIF", help_behavior_hint="")] = None
    """Write the run as a GIF of ten seconds, and open no page."""

    def run(self) -> int:
        from toolee_robot.recording.reading import read_history, recording_of

        console = Console(highlight=False)
        path = recording_of(self.recording)
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


COMMANDS = {"replay": Replay}


def _write_gif(path: Path, history: RunHistory, config: StationConfig, console: Console) -> None:
    from toolee_robot.viewer.gif import pictures, write_gif

    count, drawn = pictures(history, config)
    write_gif(path, track(drawn, "drawing", count, console=console, transient=True))
    console.print(f"GIF: {escape(str(path))}")
