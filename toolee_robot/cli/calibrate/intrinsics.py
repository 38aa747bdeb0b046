"""`toolee calibrate intrinsics`: focal lengths, principal point and distortion of a camera."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.errors import UserError

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
"""Endings of files that are images."""


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

        import cv2
        import numpy as np

        import toolee_robot
        from toolee_robot.calibration.board import SHEETS
        from toolee_robot.calibration.intrinsics import DISTORTED_FLAT, calibrate_intrinsics, write_intrinsics
        from toolee_robot.calibration.observation import find_board

        along, across = self.bars_mm
        board = SHEETS[self.sheet].board.measured(along / 1e3, across / 1e3)
        if not self.images.is_dir():
            raise UserError(f"{self.images} is no folder", code="user.image")
        views, unseen, size = [], [], None
        for path in sorted(p for p in self.images.iterdir() if p.suffix.lower() in PICTURES):
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            if image is None or image.dtype != np.uint8:
                continue  # a depth image
            grey = image if image.ndim == 2 else cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY)
            if size not in (None, grey.shape):
                raise UserError(
                    f"{path} is {grey.shape}, others are {size}: give images of one size", code="user.image_size"
                )
            size = grey.shape
            view = find_board(np.asarray(grey, np.uint8), board, DISTORTED_FLAT)
            if view is None:
                unseen.append(path.name)
            else:
                views.append(view)
        if unseen:
            console.print(f"[yellow]the board is not seen in {', '.join(unseen)}[/yellow]", soft_wrap=True)
        height, width = (0, 0) if size is None else size
        record = calibrate_intrinsics(
            views, board, (width, height), camera_serial=self.camera_serial, software=toolee_robot.__version__,
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
