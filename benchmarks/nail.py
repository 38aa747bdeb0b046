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
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from benchmarks.calibration_poses import Protocol, draw
from toolee_robot.calibration.board import SHEETS, Sheet
from toolee_robot.calibration.hand_eye.refinement import refine
from toolee_robot.calibration.hand_eye.reprojection import Views
from toolee_robot.calibration.hand_eye.solve import start
from toolee_robot.calibration.nail import see_nail
from toolee_robot.calibration.observation import camera_board
from toolee_robot.calibration.touches import KnownCamera
from toolee_robot.errors import TooleeError
from toolee_robot.frames import angle_between
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.station import StationConfig, sim_station
from toolee_robot.stations.simulated import WOOD_TILT, PrintOnWood, print_on_wood
from toolee_robot.tasks.calibration.collect import mean_frame

ASKED = {"beside [mm]": 1.0, "height [mm]": 0.3, "tilt [deg]": 1.0}
"""Largest medians that are asked for."""
MOVED = 0.03
"""Largest distance of the block from where the station file has it, along each axis of the table [m]."""
RAISED = 0.005
"""Largest error of the wood's height in the file [m]."""


@dataclass(frozen=True, eq=False)
class SimulatedNailBoard(PrintOnWood):
    """A board on the wood of a simulated station, and what is known of it.

    Attributes:
        true: The station as it is.
        camera: The camera by its calibration.
        seed: Seed of room and noise.
    """

    true: StationConfig
    camera: KnownCamera
    seed: int

    def build(self) -> SimStation:
        """Build the simulated station with the board on the wood."""
        return SimStation.build(self.true, self.seed, SimOptions(hands_over=False, boards=(self.placed,)))


def simulated_nail_board(config: StationConfig, sheet: Sheet, seed: int, tilt: float = WOOD_TILT) -> SimulatedNailBoard:
    """Print a board and lay it on the wood of a station with a calibrated camera.

    Args:
        config: The station; its camera stands where the station file says, and not where a calibration's record does.
        sheet: The sheet that is printed.
        seed: Seed of what is drawn.
        tilt: Standard deviation of each component of the wood's tilt [rad].

    Returns:
        The board.
    """
    rng = np.random.default_rng([seed, 32])
    config = replace(config, camera=config.camera.uncalibrated)
    dx, dy = rng.uniform(-MOVED, MOVED, 2).tolist()
    true = replace(config, work=config.work.moved(dx, dy, float(rng.uniform(-RAISED, RAISED))))
    laid = print_on_wood(true, sheet, rng, tilt)
    return SimulatedNailBoard(
        laid.board, laid.on_wood, laid.placed, laid.entry, laid.up, true, _calibrated(config, sheet, rng), seed
    )


def _calibrated(config: StationConfig, sheet: Sheet, rng: np.random.Generator) -> KnownCamera:
    """The camera by a calibration with drawn poses and noise."""
    k = config.camera.intrinsics
    drawn = draw(Protocol(), sheet.board, k, config.camera.X_base_camera, rng)
    Xs_camera_board = [camera_board(o.view, sheet.board, k)[0] for o in drawn.observations]
    refined = refine(Views(drawn.observations, sheet.board, k), start(drawn.observations, Xs_camera_board))
    return KnownCamera(refined.estimate.X_base_camera, refined.covariance[:6, :6], k, refined.noise.pixel)


def errors(sheet: str, seed: int) -> tuple[tuple[float, ...], bool]:
    """Errors of one lab, as `ASKED`, and whether the 95 % region of the sight has the truth."""
    lab = simulated_nail_board(sim_station(), SHEETS[sheet], seed)
    with lab.build() as simulation:
        rgb, depth = mean_frame(simulation.station.camera)
    nail = see_nail(lab.camera, lab.board, lab.on_wood, rgb, depth)
    off = (nail.entry - lab.entry) * 1e3
    tilt = float(np.rad2deg(angle_between(nail.up, lab.up)))
    inside = bool(off @ np.linalg.solve(nail.covariance * 1e6, off) <= chi2.ppf(0.95, 3))
    return (float(np.hypot(off[0], off[1])), float(abs(off[2])), tilt), inside


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
    for (name, asked_for), median, most in zip(ASKED.items(), medians, p90, strict=True):
        print(f"{name}: median {median:.2f}, 90 % {most:.2f}, asked {asked_for}")
    covered = np.mean([inside for _, inside in found])
    print(f"{len(found)} of {asked.runs} located, refused: {dict(refused)}; 95 % region: {covered:.0%} have the truth")
    return int(any(median > most for median, most in zip(medians, ASKED.values(), strict=True)))


if __name__ == "__main__":
    sys.exit(main())
