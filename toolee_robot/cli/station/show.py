"""`toolee station show`: a station file in three dimensions, in the browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from toolee_robot.cli.serving import serve
from toolee_robot.station import load_station


@dataclass(frozen=True)
class Show:
    """Show a station file in three dimensions, on a page of this computer. Ctrl-C ends it.

    Example: toolee station show lab.yaml

    Look whether everything is where it is: a half turn of the base, swapped axes and a camera that looks elsewhere are
    seen at once.
    """

    file: tyro.conf.Positional[Path]
    """The station file."""
    port: Annotated[int, tyro.conf.arg(metavar="N")] = 8080
    """Port of the page."""

    def run(self) -> int:
        load_station(self.file)  # before Rerun is imported
        console = Console(highlight=False)
        with console.status("building the picture"):
            from toolee_robot.viewer.rerun_page import RerunPage
            from toolee_robot.viewer.station_view import StationView

            view = StationView(self.file)
            page = RerunPage("station", view.blueprint(), self.port)
            view.log(page.stream)
        serve(page, console)
        return 0
