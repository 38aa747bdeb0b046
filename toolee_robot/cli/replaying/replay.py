"""`toolee replay`: a run in the browser, as a video, or through today's networks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from toolee_robot.cli.options import Flag
from toolee_robot.cli.replaying.run_list import recording_of
from toolee_robot.cli.serving import serve
from toolee_robot.errors import UserError
from toolee_robot.runtime.json_line import json_line

if TYPE_CHECKING:
    from toolee_robot.recording.history import RunHistory
    from toolee_robot.station import StationConfig
    from toolee_robot.viewer.rerun_perception import LookAgain


@dataclass(frozen=True)
class Replay:
    """Show a run in the browser: what the robot did, saw, believed and decided.

    Example: toolee replay runs/20261124-101500-seed100

    Example: toolee replay runs/20261124-101500-seed100 --rerun-perception --json

    Example: toolee replay runs/20261124-101500-seed100 --video run.mp4

    Needs the extra viewer.
    """

    recording: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RUN")]]
    """The run's folder, or its recording.mcap; a killed run's can be read up to its last written second."""
    port: Annotated[int, tyro.conf.arg(metavar="N")] = 8080
    """Port of the page; the next free one where it is in use."""
    rerun_perception: Flag = False
    """Let today's networks look at the recorded frames, and show what changed."""
    json: Flag = False
    """With --rerun-perception: print one line of JSON and open no page."""
    video: Annotated[Path | None, tyro.conf.arg(metavar="MP4", help_behavior_hint="")] = None
    """Write a video instead of opening a page."""
    speed: Annotated[float, tyro.conf.arg(metavar="X")] = 2.0
    """With --video: how much faster than the run it plays."""
    finish: Annotated[Path | None, tyro.conf.arg(metavar="MCAP", help_behavior_hint="")] = None
    """Copy what can be read of a killed run's recording into a file that every reader opens, and open no page."""

    def run(self) -> int:
        if self.json and not self.rerun_perception:
            raise UserError("--json without --rerun-perception: there is nothing to print", code="user.option")
        if self.speed <= 0.0:
            raise UserError(f"--speed {self.speed:g}: give a number over 0", code="user.option")
        from toolee_robot.recording.reading import finish_copy, read_history

        console = Console(stderr=self.json, highlight=False)
        path = recording_of(self.recording)
        if self.finish is not None:
            count = finish_copy(path, self.finish)
            console.print(f"{count} messages in {escape(str(self.finish))}")
            return 0
        history = read_history(path)
        config = history.station()
        again = self._look_again(history, config, console) if self.rerun_perception else []
        if self.json:
            print(json_line([look.figures() for look in again]), flush=True)
            return 0
        if self.video is not None:
            from toolee_robot.viewer.video import write_video

            with console.status("drawing the video"):
                write_video(self.video, history, config, self.speed)
            console.print(f"video: {escape(str(self.video))}")
            return 0
        self._show(history, config, again, console)
        return 0

    def _look_again(self, history: RunHistory, config: StationConfig, console: Console) -> list[LookAgain]:
        from toolee_robot.viewer.rerun_perception import look_again

        with console.status("looking at the recorded frames again"):
            looks = look_again(history, config)
        table = Table(title="Pose of the hammer's face in the hand: recorded, and by today's networks", box=None)
        for name in ("look", "frames", "recorded", "today", "moved [mm]", "turned [deg]", "sigma [mm]"):
            table.add_column(name, justify="right")
        for i, look in enumerate(looks, 1):
            table.add_row(str(i), *look.row())
        console.print(table)
        return looks

    def _show(self, history: RunHistory, config: StationConfig, again: list[LookAgain], console: Console) -> None:
        from toolee_robot.viewer.rerun_page import RerunPage
        from toolee_robot.viewer.run_view import RunView, blueprint

        with console.status("building the page"):
            page = RerunPage("replay", blueprint(), self.port)
            view = RunView(page.stream, history, config)
            view.update()
            for look in again:
                if look.today is not None:
                    view.log_today(look.stamp, look.today.X_hand_ee, look.today.covariance)
        console.print(escape(history.metadata.get("title", "")))
        serve(page, console)


COMMANDS = {"": Replay}
