"""`toolee devices`: the drivers that a station file may name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.table import Table

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line


@dataclass(frozen=True)
class Devices:
    """List the drivers that a station file may name, and where each is from.

    Example: toolee devices list

    A lab adds drivers in a package of its own: docs/how-to/add_a_camera.md.
    """

    action: Annotated[Literal["list"], tyro.conf.Positional]
    """What to do."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        from toolee_robot.stations.camera import camera_drivers
        from toolee_robot.stations.hand import hand_drivers

        found = {"camera": camera_drivers(), "hand": hand_drivers()}
        table = Table("device", "driver", "from", box=None, pad_edge=False)
        for kind, drivers in found.items():
            for name, source in drivers.items():
                table.add_row(kind, name, source)
        Console(stderr=self.json, highlight=False).print(table)
        if self.json:
            print(json_line(found), flush=True)
        return 0


COMMANDS = {"": Devices}
