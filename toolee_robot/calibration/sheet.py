"""The sheet with a board, to print."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from toolee_robot.calibration.board import Sheet
from toolee_robot.runtime.files import write_atomic

_INCH = 0.0254  # [m]
_CROSS = 0.004  # [m] half length of the lines of the cross through which a nail goes
_EDGE = 0.012  # [m] of the sheet that printers leave white


def board_pdf(sheet: Sheet) -> bytes:
    """Draw a board on its sheet.

    Args:
        sheet: The sheet.

    Returns:
        The PDF file. It holds no date: equal sheets give equal files.
    """
    board = sheet.board
    width, height = board.size
    x0, y0 = (sheet.width - width) / 2 + _EDGE / 2, (sheet.height - height) / 2 + _EDGE / 2
    figure = Figure(figsize=(sheet.width / _INCH, sheet.height / _INCH))
    FigureCanvasPdf(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0.0, sheet.width)
    axes.set_ylim(0.0, sheet.height)
    for x, y, w, h in board.rectangles:
        axes.add_patch(Rectangle((x0 + x, y0 + height - y - h), w, h, facecolor="black", linewidth=0))
    x, y = x0 + board.mark[0], y0 + height - board.mark[1]
    for ends in (((x - _CROSS, x + _CROSS), (y, y)), ((x, x), (y - _CROSS, y + _CROSS))):
        axes.plot(*ends, color="white", linewidth=0.5, solid_capstyle="butt")
    low, left = y0 - 0.55 * _EDGE, x0 - 0.55 * _EDGE
    axes.plot([x0, x0 + width], [low, low], color="black", linewidth=0.5, solid_capstyle="butt")
    axes.plot([left, left], [y0, y0 + height], color="black", linewidth=0.5, solid_capstyle="butt")
    tick = 0.0025
    for x in (x0, x0 + width):
        axes.plot([x, x], [low - tick, low + tick], color="black", linewidth=0.4)
    for y in (y0, y0 + height):
        axes.plot([left - tick, left + tick], [y, y], color="black", linewidth=0.4)
    note = (
        f"{board.dictionary}, {board.columns} x {board.rows} squares, nominally {board.square * 1e3:g} mm. "
        "Print at 100 %, glue on a flat plate, measure both bars."
    )
    axes.text(x0, low - 0.003, f"bar x: nominally {width * 1e3:.0f} mm", fontsize=6, va="top")
    axes.text(left - 0.003, y0, f"bar y: nominally {height * 1e3:.0f} mm", fontsize=6, rotation=90, ha="right")
    axes.text(x0 + width, low - 0.003, note, fontsize=5, va="top", ha="right")
    file = BytesIO()
    figure.savefig(file, format="pdf", metadata={"CreationDate": None, "Title": "ChArUco board"})
    return file.getvalue()


def write_board(path: Path, sheet: Sheet) -> None:
    """Write a board's PDF.

    Args:
        path: The file; its folder exists.
        sheet: The sheet.

    Raises:
        UserError: The file cannot be written.
    """
    write_atomic(path, board_pdf(sheet))
