"""`toolee annotate`: makes a test of one's own RGB-D frames by clicks on them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import text_table
from toolee_robot.cli.serving import serve
from toolee_robot.runtime.json_line import json_line


@dataclass(frozen=True)
class Annotate:
    """Make a test of your own RGB-D frames: click the tools' end effectors, get their poses with their uncertainty.

    Example: toolee annotate my_frames

    Example: toolee annotate my_frames --clicks my_frames/clicks.yaml

    Opens a page on this computer; Ctrl-C ends it and writes frames.json, which `toolee evaluate photographs my_frames`
    scores. Clicks are saved in clicks.yaml at once, and a later call goes on with them. docs/how-to/own_test.md says
    how to take the frames and what to click. Exit code 0: every end that was clicked has a pose; 1: not every one.
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """A recording by `toolee camera record`, or another folder in the BOP layout."""
    clicks: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Fit the clicks of this file, without the page."""
    port: Annotated[int, tyro.conf.arg(metavar="N")] = 8080
    """Port of the page."""
    json: Flag = False
    """Print one line of JSON; everything for people goes to standard error."""

    def run(self) -> int:
        from toolee_robot.perception.offline.annotation.frame_set import FrameSet, Session, end_record

        console = Console(stderr=self.json, highlight=False)
        frames = FrameSet(self.folder, self.clicks)
        if self.clicks is None:
            from toolee_robot.viewer.annotation_page import AnnotationPage

            page = AnnotationPage(Session(frames), self.port)
            serve(page, console, "Ctrl-C ends it and writes the test.")
        with console.status("fitting the clicks"):
            written = frames.write()
        rows = [end_record(f.name, end) for f in written for end in f.ends]
        columns = ("frame", "end", "position [mm]", "rotation [deg]", "residuals", "checks")
        if rows:
            console.print(text_table("Standard deviations of the clicked poses", columns, [r["cells"] for r in rows]))
        refused = [r for r in rows if r["problem"] is not None]
        for row in refused:
            console.print(f"[bold]{row['frame']}[/bold]: {escape(row['problem'])}", soft_wrap=True)
        complete = [f for f in written if f.complete]
        console.print(
            f"{len(complete)} of {len(frames.names)} frames in {escape(str(self.folder / 'frames.json'))}: "
            f"{sum(bool(f.ends) for f in complete)} with a tool, {sum(not f.ends for f in complete)} without",
            soft_wrap=True,
        )
        if self.json:
            record = [{k: v for k, v in row.items() if k != "cells"} for row in rows]
            print(json_line({"frames": len(complete), "ends": record}))
        return 1 if any(r["problem"] is not None or not r["known"] for r in rows) else 0


COMMANDS = {"": Annotate}
