"""`toolee calibrate intrinsics`: focal lengths, principal point and distortion of a camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from toolee_robot.cli.calibrate.board import BARS_MISSING
from toolee_robot.cli.options import Flag
from toolee_robot.errors import UserError
from toolee_robot.runtime.clock import check_real_time_factor

MIN_COUNT = 15
"""Fewest views that are asked of a person."""


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """Calibrate a camera's intrinsics from views of the board, held by hand or by the arm.

    Example: toolee calibrate intrinsics --station lab.yaml --bars-mm 361.3 258.1 --write

    Example: toolee calibrate intrinsics --station lab.yaml --rehearse

    Example: toolee calibrate intrinsics --images views --bars-mm 361.3 258.1 --camera-serial F1370001

    With --station the camera is opened, and an image is taken each time the board is held still in a new way; with
    --rehearse camera and person are emulated. With --images those of a folder are taken, as the lens gives them: no
    frames of `toolee camera record`, which are undistorted.

    Tilt the board by 30 to 45° in most images, and hold it into all corners of the image. Cameras with intrinsics from
    the factory need this only as a check.

    Exit code 0: the record is written; 1: the camera failed; 2: the images are refused, for the reason given.
    """

    images: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder of images, all of one size."""
    station: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """Your own station: its camera.device is opened, or, with --images, tells the serial number."""
    rehearse: Flag = False
    """With --station: emulate the camera, and the person with the board."""
    bars_mm: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y", help_behavior_hint="")] = None
    """Lengths of the board's two scale bars, measured on the print. A rehearsal measures its own."""
    camera_serial: Annotated[str | None, tyro.conf.arg(metavar="TEXT", help_behavior_hint="")] = None
    """Serial number of the camera, without --station."""
    sheet: Literal["a4", "a3"] = "a3"
    """The board."""
    views: Annotated[int, tyro.conf.arg(metavar="N")] = 30
    """Number of images that are taken with --station."""
    seed: int = 0
    """With --rehearse: seed of the lens, the print and how it is held."""
    real_time_factor: Annotated[float, tyro.conf.arg(metavar="0.05..1")] = 0.5
    """With --rehearse: rate of the station's time relative to wall-clock time."""
    out: Annotated[Path, tyro.conf.arg(metavar="JSON")] = Path("intrinsics.json")
    """The record."""
    write: Flag = False
    """Enter the record in `measured.yaml` beside the station file."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        self._check()
        console = Console(stderr=self.json, highlight=False)
        from toolee_robot.cli.calibrate.intrinsics_entry import camera_of, check_entry, enter
        from toolee_robot.cli.calibrate.intrinsics_job import IntrinsicsJob

        camera = None if self.station is None else camera_of(self.station)
        if self.write:
            assert self.station is not None
            check_entry(self.station, rehearsed=self.rehearse)
        job = IntrinsicsJob(self.sheet, console)
        bars = None if self.bars_mm is None else (self.bars_mm[0] / 1e3, self.bars_mm[1] / 1e3)
        if self.rehearse:
            assert camera is not None
            job.rehearse(camera, self.views, self.seed, self.real_time_factor)
        elif self.images is not None:
            assert bars is not None
            serial = self.camera_serial if camera is None or camera.device is None else camera.device.serial
            assert serial is not None
            job.from_images(self.images, bars, serial)
        else:
            assert camera is not None
            assert bars is not None
            job.live(camera, self.views, bars)
        job.write(self.out)
        if self.write:
            assert self.station is not None
            enter(self.station, self.out)
        job.conclude(self.out, self.station if self.write else None, self.json)
        return 0

    def _check(self) -> None:
        if self.images is None and self.station is None:
            raise UserError(
                "give --station, whose camera takes the images, or --images, a folder of them", code="user.option"
            )
        if self.rehearse and (self.station is None or self.images is not None):
            raise UserError(
                "--rehearse without --station, or with --images: give the station file that is rehearsed, alone",
                code="user.no_station",
            )
        if self.station is not None and self.camera_serial is not None:
            raise UserError("--camera-serial with --station: the file tells it", code="user.option")
        if self.station is None and self.camera_serial is None:
            raise UserError(
                "--camera-serial is missing: the record holds for one camera, give its serial number, or --station",
                code="user.option",
            )
        if self.rehearse and self.bars_mm is not None:
            raise UserError("--bars-mm with --rehearse: the emulated person measures the print", code="user.option")
        if not self.rehearse and self.bars_mm is None:
            raise UserError(BARS_MISSING, code="user.board_scale_unknown")
        if self.write and self.station is None:
            raise UserError("--write needs --station: the station file to write to", code="user.option")
        if not MIN_COUNT <= self.views <= 200 or self.seed < 0:
            raise UserError(f"give --views {MIN_COUNT} to 200, and --seed 0 or more", code="user.option")
        check_real_time_factor(self.real_time_factor, "127.0.0.1")
