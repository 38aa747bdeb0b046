"""`toolee calibrate intrinsics`: focal lengths, principal point and distortion of a camera."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """Calibrate a camera's intrinsics from images of the board, held by hand or by the arm.

    Example: toolee calibrate intrinsics --images views --bars-mm 361.3 258.1 --camera-serial F1370001

    Tilt the board by 30 to 45° in most images, and hold it into all corners of the image. Cameras with intrinsics from
    the factory need this only as a check.

    Exit code 0: the record is written; 2: the images are refused, for the reason given.
    """

    images: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder of images, all of one size."""
    bars_mm: Annotated[tuple[float, float], tyro.conf.arg(metavar="X Y")]
    """Lengths of the board's two scale bars, measured on the print."""
    camera_serial: Annotated[str, tyro.conf.arg(metavar="TEXT")]
    """Serial number of the camera."""
    sheet: Literal["a4", "a3"] = "a3"
    """The board."""
    out: Annotated[Path, tyro.conf.arg(metavar="JSON")] = Path("intrinsics.json")
    """The record."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        console = Console(stderr=self.json, highlight=False)
        from datetime import UTC, datetime

        import toolee_robot
        from toolee_robot.calibration.board import SHEETS
        from toolee_robot.calibration.intrinsics import calibrate_intrinsics, read_views, write_intrinsics

        along, across = self.bars_mm
        board = SHEETS[self.sheet].board.measured(along / 1e3, across / 1e3)
        views, unseen, size = read_views(self.images, board)
        if unseen:
            console.print(f"[yellow]the board is not seen in {', '.join(unseen)}[/yellow]", soft_wrap=True)
        record = calibrate_intrinsics(
            views, board, size, camera_serial=self.camera_serial, software=toolee_robot.__version__,
            measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
        )  # fmt: skip
        write_intrinsics(self.out, record)
        K = record.intrinsics
        for name, value, sigma in zip(("fx", "fy", "cx", "cy"), (K.fx, K.fy, K.cx, K.cy), record.sigma, strict=True):
            console.print(f"  {name}  {value:9.3f} ± {2 * sigma:.3f} px")
        console.print(
            f"  reprojection {record.reprojection:.3f} px, held out {record.held_out:.3f} px, {record.views} views, "
            f"{100 * record.covered:.0f} % of the image\n  the lens displaces pixels by up to "
            f"{record.largest_distortion:.2f} px"
            + (": undistort the images before anything is measured in them" if record.distorts else ": negligible")
        )
        console.print(f"  {self.out}")
        if self.json:
            print(json_line(asdict(record)), flush=True)
        return 0
