"""`toolee camera bench`: time and error of registration and undistortion on this machine."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from rich.console import Console
from rich.table import Table

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line


@dataclass(frozen=True)
class BenchRegistration:
    """Measure the registration of depth to colour: its time in one thread, its error on scenes that are known exactly.

    Example: toolee camera bench

    The depth camera is one of 512x424, with a lens like the Kinect v2's. The time of the undistortion is that of colour
    and depth of 1280x720 through one lens.
    """

    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        import cv2

        from toolee_robot.devices.cameras.registration_benchmark import (
            COLORS,
            measure_registration,
            undistortion_time,
        )

        console = Console(stderr=self.json, highlight=False)
        cv2.setNumThreads(1)
        figures = [measure_registration(color) for color in COLORS]
        table = Table("colour", "time", "surfaces", "99.9 %", "edges", "outwards", "holes", box=None, pad_edge=False)
        for f in figures:
            table.add_row(
                f.color,
                f"{f.milliseconds:.1f} ms",
                f"{f.surface_rms:.2f} px",
                f"{f.surface_most:.2f} px",
                f"{f.edge_rms:.2f} px",
                f"{f.edge_mean:+.2f} px",
                f"{f.holes:.2%}",
            )
        console.print(table)
        console.print("Errors are root mean squares, but the 99.9 % of surfaces and the mean of edges outwards.")
        undistortion = undistortion_time()
        console.print(f"Undistortion of 1280x720, colour and depth: {undistortion:.1f} ms.")
        if self.json:
            told = {"registration": [asdict(f) for f in figures], "undistortion_ms": undistortion}
            print(json_line(told), flush=True)
        return 0
