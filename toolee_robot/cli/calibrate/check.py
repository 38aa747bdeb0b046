"""`toolee calibrate check`: a touch test against a corner of a board that took no part."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.errors import UserError
from toolee_robot.frames import BaseFrame
from toolee_robot.runtime.json_line import json_line


@dataclass(frozen=True, kw_only=True)
class Check:
    """Compare a board's corner as the camera sees it with the place where the arm touches it.

    Example: toolee calibrate check --record camera.json --image board.png --bars-mm 251.2 179.4 --corner 0
    --touched-mm 602.1 -148.7 262.3 --frame pendant_base

    Lay a board in the camera's view, where the arm reaches it; take an image; touch a corner with a pointed tip as the
    TCP, and read X Y Z on the pendant. The result is added to the record, which is signed anew. Good residuals do not
    guarantee accuracy: only this does.

    Exit code 0: the two agree; 1: they do not; 2: invalid input.
    """

    record: Annotated[Path, tyro.conf.arg(metavar="JSON")]
    """The calibration's record."""
    image: Annotated[Path, tyro.conf.arg(metavar="PNG")]
    """Image of the board by the calibrated camera."""
    bars_mm: Annotated[tuple[float, float], tyro.conf.arg(metavar="X Y")]
    """Lengths of the board's two scale bars, measured on the print."""
    corner: Annotated[int, tyro.conf.arg(metavar="N")]
    """Number of the inner corner: 0 is the first, beside the board's origin, counted along x first."""
    touched_mm: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")]
    """Place of the tip on the corner."""
    frame: Literal["pendant_base", "base_link"]
    """Frame of that place: the pendant's Base, or ROS's base_link."""
    touch_error_mm: Annotated[float, tyro.conf.arg(metavar="MM")]
    """Standard deviation of a touch about one axis, such as 0.5: touch a corner five times, from different sides."""
    sheet: Literal["a4", "a3"] = "a4"
    """The board."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        if not 0.01 <= self.touch_error_mm <= 10.0:
            raise UserError(f"--touch-error-mm {self.touch_error_mm}: give 0.01 to 10", code="user.option")
        console = Console(stderr=self.json, highlight=False)
        from datetime import UTC, datetime

        from toolee_robot.calibration.board import SHEETS
        from toolee_robot.calibration.observation import find_board
        from toolee_robot.calibration.record import read_record, write_record
        from toolee_robot.calibration.session import read_image
        from toolee_robot.calibration.touch_check import cause, see_corner, touch_check

        record = read_record(self.record)
        along, across = self.bars_mm
        board = SHEETS[self.sheet].board.measured(along / 1e3, across / 1e3)
        view = find_board(read_image(self.image, record.intrinsics), board)
        if view is None:
            raise UserError(f"no board is seen in {self.image}: nearer, or more light", code="user.board_not_seen")
        seen = see_corner(record, board, view, self.corner)
        X = BaseFrame(self.frame).X_base_this
        touched = X[:3, :3] @ (np.array(self.touched_mm) / 1e3)
        now = datetime.now(UTC).isoformat(timespec="seconds")
        check = touch_check(
            record, seen, touched, self.touch_error_mm / 1e3, f"corner {self.corner}, {self.image.name}", now
        )
        write_record(self.record, record.checked(check))
        agrees = check.error <= check.allowed
        color = "green" if agrees else "red"
        console.print(
            f"seen at ({_mm(check.seen)}) mm, touched at ({_mm(check.touched)}) mm, in base_link\n"
            f"[{color}]{check.error * 1e3:.2f} mm apart[/{color}], {check.allowed * 1e3:.2f} mm are explained by "
            "calibration, image and touch (95 %)"
        )
        if not agrees:
            console.print(f"[red]{cause(check)}[/red]", soft_wrap=True)
        if self.json:
            print(json_line({**asdict(check), "agrees": agrees}), flush=True)
        return int(not agrees)


def _mm(p: tuple[float, float, float]) -> str:
    return ", ".join(f"{1e3 * v:.1f}" for v in p)
