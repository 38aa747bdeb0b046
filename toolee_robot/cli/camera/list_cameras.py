"""`toolee camera list`: the cameras of this computer."""

from __future__ import annotations

from dataclasses import dataclass

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.errors import UserError


@dataclass(frozen=True)
class ListCameras:
    """List the RealSense and Orbbec cameras that are connected, and the drivers that a station file may name.

    Example: toolee camera list

    Exit code 0, also where there is no camera.
    """

    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        from toolee_robot.devices.cameras import orbbec, realsense
        from toolee_robot.stations.camera import camera_drivers

        console = Console(stderr=self.json, highlight=False)
        found: list[dict[str, str]] = []
        for maker, describe in (
            ("RealSense", realsense.describe_connected),
            ("Orbbec", orbbec.describe_connected),
        ):
            try:
                cameras = describe()
            except UserError as error:
                console.print(f"[yellow]{escape(str(error))}[/yellow]")
                continue
            found += cameras
            if not cameras:
                console.print(f"No {maker} is connected.")
        if found:
            table = Table("model", "serial", "firmware", "port", box=None, pad_edge=False)
            for camera in found:
                table.add_row(camera["model"], camera["serial"], camera["firmware"], camera["port"])
            console.print(table)
        drivers = camera_drivers()
        console.print(f"Drivers: {', '.join(drivers)}. Other cameras are listed by their makers' programs.")
        if self.json:
            print(json_line({"cameras": found, "drivers": drivers}), flush=True)
        return 0
