"""How well the camera locates a nail by a board on the wood, over many simulated labs.

    python -m benchmarks.nail --runs 100

Each run draws a calibration of the camera, the print's scale, place and tilt of the wood, how the board lies there, and
by how much a person's measurements are off, and looks at rendered frames. Exit code 1: a figure is not met.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from toolee_robot.calibration.board import SHEETS
from toolee_robot.calibration.nail import combine, see_nail
from toolee_robot.errors import TooleeError
from toolee_robot.frames import angle_between
from toolee_robot.station import sim_station
from toolee_robot.stations.simulated import simulated_nail_board
from toolee_robot.tasks.calibration.collect import mean_frame

ASKED = {"beside [mm]": 1.0, "height [mm]": 0.3, "tilt [deg]": 1.0}
"""Largest medians that are asked for."""
NAMES = (*ASKED, "beside, touched too [mm]", "height, touched too [mm]")


def errors(sheet: str, seed: int) -> tuple[tuple[float, ...], bool]:
    """Errors of one lab, as `NAMES`, and whether the 95 % region of the sight has the truth."""
    lab = simulated_nail_board(sim_station(), SHEETS[sheet], seed)
    with lab.build() as simulation:
        rgb, depth = mean_frame(simulation.station.camera)
    nail = see_nail(lab.camera, lab.board, lab.on_wood, rgb, depth)
    both = combine(nail, lab.touched, lab.true.work.nail_protrusion)
    off, off_both = (nail.entry - lab.entry) * 1e3, (both.entry - lab.entry) * 1e3
    tilt = float(np.rad2deg(angle_between(nail.up, lab.up)))
    inside = bool(off @ np.linalg.solve(nail.covariance * 1e6, off) <= chi2.ppf(0.95, 3))
    beside, beside_both = float(np.hypot(off[0], off[1])), float(np.hypot(off_both[0], off_both[1]))
    return (beside, float(abs(off[2])), tilt, beside_both, float(abs(off_both[2]))), inside


def main(arguments: Sequence[str] | None = None) -> int:
    """Look at the nails of many labs and print the errors."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.nail", description="Locate nails by a board.")
    parser.add_argument("--runs", type=int, default=100, help="simulated labs")
    parser.add_argument("--sheet", choices=list(SHEETS), default="a3")
    parser.add_argument("--seed", type=int, default=0, help="of the first; the others follow")
    asked = parser.parse_args(arguments)
    found, refused = [], Counter[str]()
    for k in range(asked.runs):
        try:
            found.append(errors(asked.sheet, asked.seed + k))
        except TooleeError as error:
            refused[error.code] += 1
    values = np.array([values for values, _ in found])
    medians, p90 = np.quantile(values, [0.5, 0.9], axis=0)
    for name, median, most in zip(NAMES, medians, p90, strict=True):
        print(f"{name}: median {median:.2f}, 90 % {most:.2f}, asked {ASKED.get(name, '-')}")
    covered = np.mean([inside for _, inside in found])
    print(f"{len(found)} of {asked.runs} located, refused: {dict(refused)}; 95 % region: {covered:.0%} have the truth")
    return int(any(median > most for median, most in zip(medians, ASKED.values(), strict=False)))


if __name__ == "__main__":
    sys.exit(main())
