"""`toolee devices`: the drivers that a station file may name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro
from rich.table import Table

from toolee_robot.cli.options import JsonOption


@dataclass(frozen=True)
class Devices(JsonOption):
    """List the drivers that a station file may name, and where each is from.

    Example: toolee devices list

    A lab adds drivers in a package of its own: docs/how-to/add_a_camera.md.
    """

    action: Annotated[Literal["list"], tyro.conf.Positional]
    """What to do."""

    def run(self) -> int:
        from toolee_robot.devices.hands import hand_drivers
        from toolee_robot.stations.camera import camera_drivers

        found = {"camera": camera_drivers(), "hand": hand_drivers()}
        table = Table("device", "driver", "from", box=None, pad_edge=False)
        for kind, drivers in found.items():
            for name, source in drivers.items():
                table.add_row(kind, name, source)
        self.console.print(table)
        self.tell(found)
        return 0


COMMANDS = {"": Devices}
