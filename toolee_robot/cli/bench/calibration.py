"""`toolee bench-calibration`: accuracy and coverage of the camera's calibration on synthetic poses."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.table import Table

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.cli.progress import progress_bars
from toolee_robot.errors import UserError


@dataclass(frozen=True)
class BenchCalibration:
    """Measure accuracy and coverage of the camera's calibration on synthetic poses.

    Example: toolee bench-calibration --runs 200

    Each run draws poses, noise and the board's place anew. Exit code 1: a figure is not met.
    """

    runs: Annotated[int, tyro.conf.arg(metavar="N")] = 200
    """Runs of each protocol."""
    sheet: Literal["a4", "a3"] = "a4"
    """Board."""
    seed: int = 0
    """Seed of the draws."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        if self.runs < 10 or self.seed < 0:
            raise UserError("give --runs 10 or more, and --seed 0 or more", code="user.option")
        console = Console(stderr=self.json, highlight=False)
        from toolee_robot.calibration.board import SHEETS
        from toolee_robot.calibration.hand_eye.benchmark import PROTOCOLS, measure
        from toolee_robot.station import CameraConfig

        camera, board = CameraConfig(), SHEETS[self.sheet].board
        console.print(
            f"{self.sheet.upper()} board, squares of {board.square * 1e3:g} mm; camera {camera.width} x "
            f"{camera.height}, focal length {camera.fx:g} px; error of a point 0.95 m before it",
            soft_wrap=True,
        )
        figures = []
        with progress_bars(console) as report:
            for name in PROTOCOLS:
                figures.append(
                    measure(
                        name, board, camera.intrinsics, camera.X_base_camera, self.runs, self.seed,
                        lambda done, name=name: report(name, done, self.runs),  # type: ignore[misc]
                    )
                )  # fmt: skip
        table = Table()
        for column in ("protocol", "median", "p90", "asked", "covered", "refused", "best closed form"):
            table.add_column(column, justify="left" if column == "protocol" else "right")
        for f in figures:
            method = min(f.closed_forms, key=lambda m: f.closed_forms[m])
            asked = "" if f.largest_error is None else f"{f.largest_error * 1e3:.1f}"
            covered = f.covered if f.covered_accepted is None else f.covered_accepted
            table.add_row(
                f.protocol, f"{f.error * 1e3:.2f}", f"{f.error_90 * 1e3:.2f}", asked, f"{100 * covered:.0f} %",
                f"{f.refused}", f"{method} {f.closed_forms[method] * 1e3:.1f}",
            )  # fmt: skip
        console.print(table)
        console.print("[dim]in mm; covered: runs whose 95 % region has the truth, 90 to 99 % asked[/dim]")
        if self.json:
            print(json_line([asdict(f) | {"met": f.met} for f in figures]), flush=True)
        return int(not all(f.met for f in figures))


COMMANDS = {"": BenchCalibration}
