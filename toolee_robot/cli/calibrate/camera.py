"""`toolee calibrate camera`: the pose of the fixed camera in the robot's base."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.config import StationConfig, load_station
from toolee_robot.errors import UserError


@dataclass(frozen=True)
class Camera:
    """Calibrate the fixed camera to the robot, from views of a board on the flange.

    Example: toolee calibrate camera

    Example: toolee calibrate camera --images session --config lab.yaml --bars-mm 361.3 258.1

    Without --images a simulated lab is calibrated: it prints a board, screws it on the flange, measures it, and drives
    it through poses under the supervisor. With --images the poses and images of a folder are taken.

    Exit code 0: the record is written; 1: a device failed; 2: poses or images are refused, for the reason given.
    """

    images: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder with images and poses.json, see docs/how-to/calibrate.md."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """The station file: the arm's kinematics, and where the camera was measured by hand."""
    sheet: Literal["a4", "a3"] = "a3"
    """The board, as `toolee calibrate board` drew it."""
    bars_mm: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y", help_behavior_hint="")] = None
    """Lengths of the two scale bars, measured on the print. A simulated lab measures its own."""
    poses: Annotated[int, tyro.conf.arg(metavar="N")] = 20
    """Simulated lab: number of poses."""
    plate_distance: Annotated[float, tyro.conf.arg(metavar="M")] = 0.12
    """Simulated lab: distance of the print from the flange."""
    plate_mass: Annotated[float, tyro.conf.arg(metavar="KG")] = 1.2
    """Simulated lab: mass of plate and holder."""
    seed: int = 0
    """Simulated lab: seed of the print, its place on the flange, the room and the noise."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("calibrations")
    """Parent of the calibration's folder, which holds camera.json, the record, report.html and the images."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        if self.images is None and self.bars_mm is not None:
            raise UserError("--bars-mm without --images: the simulated lab measures its own print", code="user.option")
        if self.images is not None and self.bars_mm is None:
            raise UserError(
                "--bars-mm is missing: measure the two scale bars on your print and give their lengths in "
                "millimetres; no printer keeps the scale",
                code="user.board_scale_unknown",
            )
        if not 8 <= self.poses <= 100 or self.seed < 0:
            raise UserError("give --poses 8 to 100, and --seed 0 or more", code="user.option")
        config = StationConfig() if self.config is None else load_station(self.config)
        console = Console(stderr=self.json, highlight=False)
        from toolee_robot.cli.calibrate.camera_job import CameraJob
        from toolee_robot.cli.run_folder import run_folder

        job = CameraJob(config, self.sheet, console)
        with run_folder(self.out, "camera") as folder:
            if self.images is None:
                job.simulate(folder.path, self.poses, self.plate_distance, self.plate_mass, self.seed)
            else:
                assert self.bars_mm is not None
                bars = (self.bars_mm[0] / 1e3, self.bars_mm[1] / 1e3)
                job.from_images(folder.path, self.images, bars, measured_camera=self.config is not None)
            place = folder.keep()
        job.conclude(place, self.json)
        return 0
