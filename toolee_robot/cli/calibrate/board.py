"""`toolee calibrate board`: the board to print."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

BARS_MISSING = (
    "--bars-mm is missing: measure the two scale bars on your print and give their lengths in millimetres; no printer "
    "keeps the scale"
)
"""Why views of a print that nobody has measured are refused."""


@dataclass(frozen=True)
class PrintBoard:
    """Write a ChArUco board as a PDF, with two scale bars to be measured on the print.

    Example: toolee calibrate board --sheet a3 --out board.pdf

    Glue the print on a flat, stiff plate. Printers scale: measure both bars with a steel rule to a tenth of a
    millimetre, and tell the lengths to `toolee calibrate camera --bars-mm`.
    """

    sheet: Literal["a4", "a3"] = "a3"
    """Size of the paper. A camera of 512 pixels in width finds an A4 up to 0.9 m away, an A3 up to 1.2 m."""
    out: Annotated[Path, tyro.conf.arg(metavar="PDF")] = Path("board.pdf")
    """The file."""

    def run(self) -> int:
        from toolee_robot.calibration.board import SHEETS
        from toolee_robot.calibration.print import write_board

        sheet = SHEETS[self.sheet]
        write_board(self.out, sheet)
        x, y = sheet.board.size
        Console(highlight=False).print(
            f"{self.out}: {sheet.board.columns} x {sheet.board.rows} squares, the bars nominally {x * 1e3:.0f} and "
            f"{y * 1e3:.0f} mm.\nPrint it at 100 %, glue it on a flat plate, measure both bars on the print."
        )
        return 0
