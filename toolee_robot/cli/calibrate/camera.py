"""`toolee calibrate camera`: the pose of the fixed camera in the robot's base."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from toolee_robot.cli.calibrate.board import BARS_MISSING
from toolee_robot.cli.options import Flag
from toolee_robot.errors import TooleeError, UserError
from toolee_robot.runtime.clock import check_real_time_factor
from toolee_robot.station import (
    SIMULATED,
    StationConfig,
    load_lab_station,
    load_station,
    measured_path,
    sim_station,
    write_measured,
)

SIMULATED_PLATE = 0.12, 1.2
"""Distance of a simulated print from the flange [m], and mass of its plate [kg]."""


@dataclass(frozen=True)
class Camera:
    """Calibrate the fixed camera to the robot, from views of a board on the flange.

    Example: toolee calibrate camera

    Example: toolee calibrate camera --station lab.yaml --bars-mm 361.3 258.1 --plate-distance 0.12 --plate-mass 1.2

    Example: toolee calibrate camera --images session --config lab.yaml --bars-mm 361.3 258.1

    With --station the arm drives the board through poses before the camera, slowly and under the supervisor, while
    somebody holds the switch; with --rehearse every device is emulated. With --images the poses and images of a folder
    are taken. Without either a simulated lab is calibrated.

    Exit code 0: the record is written; 1: a device failed; 2: poses or images are refused, for the reason given. Images
    that were taken until then stay, for --images.
    """

    images: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder with images and poses.json, see docs/how-to/calibrate.md."""
    station: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """Your own station: its arm moves."""
    rehearse: Flag = False
    """With --station: emulate every device, in front of a simulated cell."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """The station file without --station: the arm's kinematics, and where the camera was measured by hand."""
    sheet: Literal["a4", "a3"] = "a3"
    """The board, as `toolee calibrate board` drew it."""
    bars_mm: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y", help_behavior_hint="")] = None
    """Lengths of the two scale bars, measured on the print. A simulated lab measures its own."""
    poses: Annotated[int, tyro.conf.arg(metavar="N")] = 20
    """Number of poses to drive to."""
    plate_distance: Annotated[float | None, tyro.conf.arg(metavar="M", help_behavior_hint="(simulated: 0.12)")] = None
    """Distance of the print from the flange."""
    plate_mass: Annotated[float | None, tyro.conf.arg(metavar="KG", help_behavior_hint="(simulated: 1.2)")] = None
    """Mass of plate and holder."""
    seed: int = 0
    """Seed of the planned views; simulated: also of the print, its place on the flange, the room and the noise."""
    real_time_factor: Annotated[float, tyro.conf.arg(metavar="0.05..1")] = 0.5
    """With --rehearse: rate of the station's time relative to wall-clock time."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("calibrations")
    """Parent of the calibration's folder, which holds camera.json, the record, report.html and the images."""
    write: Flag = False
    """Enter the record in `measured.yaml` beside the station file."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        self._check()
        if self.station is not None:
            config = load_lab_station(self.station)
            self._check_entry(config)
        else:
            config = sim_station() if self.config is None else load_station(self.config)
        console = Console(stderr=self.json, highlight=False)
        from toolee_robot.app.run_folder import run_folder
        from toolee_robot.calibration.session import FILE
        from toolee_robot.cli.calibrate.camera_job import RECORD, CameraJob

        job = CameraJob(config, self.sheet, console)
        bars = None if self.bars_mm is None else (self.bars_mm[0] / 1e3, self.bars_mm[1] / 1e3)
        distance, mass = self.plate_distance or SIMULATED_PLATE[0], self.plate_mass or SIMULATED_PLATE[1]
        with run_folder(self.out, "camera") as folder:
            try:
                if self.images is not None:
                    assert bars is not None
                    job.from_images(folder.path, self.images, bars, measured_camera=self.config is not None)
                elif self.station is None:
                    job.simulate(folder.path, self.poses, distance, mass, self.seed)
                elif self.rehearse:
                    job.rehearse(folder.path, self.poses, distance, mass, self.seed, self.real_time_factor)
                else:
                    assert bars is not None
                    job.live(folder.path, self.poses, distance, mass, self.seed, bars)
            except (TooleeError, KeyboardInterrupt):
                if (folder.path / FILE).is_file():  # images were taken, which cost a person's time
                    job.tell_kept(folder.keep())
                raise
            place = folder.keep()
        if self.write:
            assert self.station is not None
            record = os.path.relpath(place / RECORD, self.station.parent)
            write_measured(self.station, calibration={"record": record})
        job.conclude(place, measured_path(self.station) if self.write and self.station else None, self.json)
        return 0

    def _check_entry(self, config: StationConfig) -> None:
        """Refuse before anything moves what --write could not enter, or must not."""
        known = config.calibration
        if not self.write or known is None:
            return
        if known.record is None:
            raise UserError(
                f"{self.station} gives its calibration by hand (measured_on and others): take the section out first, "
                "since the record that --write enters says the same of its own",
                code="user.calibration_by_hand",
            )
        if self.rehearse and known.robot_serial != SIMULATED:
            raise UserError(
                f"{self.station} names the calibration of robot {known.robot_serial}: that of a rehearsal would take "
                "its place. Rehearse with a copy of the file, or without --write",
                code="user.calibration_is_real",
            )

    def _check(self) -> None:
        if self.images is not None and self.station is not None:
            raise UserError(
                "--images with --station: images that were taken, or a station that takes them", code="user.option"
            )
        if self.station is not None and self.config is not None:
            raise UserError("--config with --station: --station alone, it is the same file", code="user.option")
        if self.rehearse and self.station is None:
            raise UserError(
                "--rehearse without --station: give the station file that is rehearsed", code="user.no_station"
            )
        real = self.images is not None or (self.station is not None and not self.rehearse)
        if not real and self.bars_mm is not None:
            where = "with --rehearse" if self.rehearse else "without --images or --station"
            raise UserError(f"--bars-mm {where}: the simulated lab measures its own print", code="user.option")
        if real and self.bars_mm is None:
            raise UserError(BARS_MISSING, code="user.board_scale_unknown")
        if real and self.images is None and (self.plate_distance is None or self.plate_mass is None):
            raise UserError(
                "--plate-distance and --plate-mass are missing: measure how far the print is from the flange, and "
                "weigh plate and holder: the arm moves by them",
                code="user.plate_unmeasured",
            )
        if self.write and self.station is None:
            raise UserError("--write needs --station: the station file to write to", code="user.option")
        if not 8 <= self.poses <= 100 or self.seed < 0:
            raise UserError("give --poses 8 to 100, and --seed 0 or more", code="user.option")
        check_real_time_factor(self.real_time_factor, "127.0.0.1")
