"""`toolee bench-nail`: how well the camera locates a nail, over many simulated labs."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.table import Table

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.cli.progress import progress_bars
from toolee_robot.errors import TooleeError, UserError

ASKED = {"lateral": 1.0, "height": 0.3, "tilt": 1.0}
"""Largest medians that are asked for [mm, mm, deg]."""
NAMES = ("lateral", "height", "tilt", "lateral, touched too", "height, touched too")
"""The errors that are measured."""


@dataclass(frozen=True)
class BenchNail:
    """Measure how well the camera locates a nail by a board on the wood, over many simulated labs.

    Example: toolee bench-nail --runs 100

    Each run draws a calibration of the camera, the print's scale, place and tilt of the wood, how the board lies there,
    and by how much a person's measurements are off, and looks at rendered frames. Exit code 1: a figure is not met.
    """

    runs: Annotated[int, tyro.conf.arg(metavar="N")] = 100
    """Simulated labs."""
    sheet: Literal["a4", "a3"] = "a3"
    """The board."""
    seed: int = 0
    """Seed of the first; the others follow."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        if self.runs < 5 or self.seed < 0:
            raise UserError("give --runs 5 or more, and --seed 0 or more", code="user.option")
        console = Console(stderr=self.json, highlight=False)
        import numpy as np

        found: list[tuple[tuple[float, ...], bool]] = []
        refused: Counter[str] = Counter()
        with progress_bars(console) as report:
            for k in range(self.runs):
                try:
                    found.append(_errors(self.sheet, self.seed + k))
                except TooleeError as error:
                    refused[error.code] += 1
                report("labs", k + 1, self.runs)
        if not found:
            raise UserError(f"every image was refused: {dict(refused)}", code="user.board_not_seen")
        values = np.array([errors for errors, _ in found])
        medians = dict(zip(NAMES, np.median(values, axis=0).tolist(), strict=True))
        p90 = dict(zip(NAMES, np.quantile(values, 0.9, axis=0).tolist(), strict=True))
        covered = float(np.mean([inside for _, inside in found]))
        table = Table()
        for column in ("error", "median", "p90", "asked"):
            table.add_column(column, justify="left" if column == "error" else "right")
        for name in NAMES:
            unit = "°" if name == "tilt" else " mm"
            asked = f"{ASKED[name]:g}{unit}" if name in ASKED else ""
            table.add_row(name, f"{medians[name]:.2f}{unit}", f"{p90[name]:.2f}{unit}", asked)
        console.print(table)
        console.print(
            f"{len(found)} of {self.runs} located; the 95 % region has the truth in {100 * covered:.0f} %"
            + (f"; refused: {dict(refused)}" if refused else "")
        )
        met = all(medians[name] <= asked for name, asked in ASKED.items())
        if self.json:
            record = {"runs": self.runs, "located": len(found), "refused": dict(refused), "covered": covered}
            print(json_line({**record, "medians": medians, "p90": p90, "met": met}), flush=True)
        return int(not met)


def _errors(sheet: str, seed: int) -> tuple[tuple[float, ...], bool]:
    """Errors of one lab, as `NAMES` [mm, deg], and whether the 95 % region of the sight has the truth."""
    import numpy as np
    from scipy.stats import chi2

    from toolee_robot.calibration.board import SHEETS
    from toolee_robot.calibration.nail import combine, see_nail
    from toolee_robot.frames import angle_between
    from toolee_robot.station import StationConfig
    from toolee_robot.stations.simulated_nail import simulated_nail_board
    from toolee_robot.tasks.calibration.still_frame import mean_frame

    lab = simulated_nail_board(StationConfig(), SHEETS[sheet], seed)
    with lab.build() as simulation:
        rgb, depth = mean_frame(simulation.station.camera)
    nail = see_nail(lab.camera, lab.board, lab.on_wood, rgb, depth)
    both = combine(nail, lab.touched, lab.true.work.nail_protrusion)
    off, off_both = (nail.entry - lab.entry) * 1e3, (both.entry - lab.entry) * 1e3
    tilt = float(np.rad2deg(angle_between(nail.up, lab.up)))
    inside = bool(off @ np.linalg.solve(nail.covariance * 1e6, off) <= chi2.ppf(0.95, 3))
    beside, beside_both = float(np.hypot(off[0], off[1])), float(np.hypot(off_both[0], off_both[1]))
    return (beside, float(abs(off[2])), tilt, beside_both, float(abs(off_both[2]))), inside


COMMANDS = {"": BenchNail}
