"""The pages of a camera calibration: the board to print, and the self-contained report."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from toolee_robot.calibration.board import Sheet
from toolee_robot.calibration.hand_eye.refinement import confidence_factor, point_covariance
from toolee_robot.calibration.record import CalibrationRecord
from toolee_robot.frames import HALF_TURN
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.html_page import Page
from toolee_robot.runtime.images import read_image
from toolee_robot.runtime.pose_text import pose_text

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


_THUMBNAIL = 300  # [px] width
_ACROSS = 4
_DISTANCES = (0.4, 0.6, 0.95, 1.5)  # [m] before the camera
_BLUE, _ORANGE = "#12609e", "#c8551b"


def calibration_report(record: CalibrationRecord, folder: Path, signature: str, missing: list[str]) -> str:
    """Write the report of a calibration.

    Args:
        record: The record.
        folder: Folder of the images that the record's poses name; those that are not there are left out.
        signature: The record's signature.
        missing: Kinds of views that the poses lack.

    Returns:
        The page, HTML.
    """
    page = Page(
        "Camera calibration",
        f"{record.measured_at} · robot {record.robot_model} {record.robot_serial} · camera {record.camera_serial}",
    )
    page.section("Result")
    page.cards(
        [
            (f"± {record.target_radius * 1e3:.2f} mm", f"95 % region of a point {record.target[2]:g} m away"),
            (f"{record.residual * 1e3:.2f} mm", "error of the board's corners on held-out poses"),
            (f"{record.largest_shift * 1e3:.2f} mm", "largest change when one pose is left out"),
            (f"{len(record.poses)}", "poses that show the board"),
        ]
    )
    page.definitions(_result(record))
    if missing:
        page.paragraph(f"Fewer than two views each: {', '.join(missing)}. More of these make the result safer.")
    page.section("How far it can be relied on")
    page.paragraph(
        "Size of the region that has the true place of a point with a probability of 95 %, by the point's distance "
        "on the optical axis. It includes the noise of corners, arm and board scale, estimated from these poses. "
        "It excludes errors that all poses share, such as wrong intrinsics or kinematics. Only a touch test finds "
        "those: toolee calibrate check."
    )
    page.table(["distance", "half axes of the region, mm"], [_region(record, z) for z in _DISTANCES])
    page.heading("Touch tests")
    if record.checks:
        page.table(
            ["what", "date", "error, mm", "explained, mm", "verdict"],
            [
                [c.what, c.measured_at, f"{c.error * 1e3:.2f}", f"{c.allowed * 1e3:.2f}",
                 "agrees" if c.error <= c.allowed else "disagrees"]
                for c in record.checks
            ],
        )  # fmt: skip
    else:
        page.paragraph("None yet. Good residuals do not guarantee accuracy.")
    page.section("Poses")
    page.picture(_bars(record), "Error of each pose: by the other poses (held out), and within its own image.")
    page.picture(_coverage(record), "Corners in the image, all poses.")
    sheet = _contact_sheet(record, folder)
    if sheet is not None:
        page.picture(sheet, "The images and the corners that were found.")
    page.table(
        ["pose", "corners", "reprojection, px", "held out, mm", "weight"],
        [
            [p.name, f"{len(p.ids)}", f"{p.reprojection:.2f}", f"{p.held_out * 1e3:.2f}", f"{p.weight:.2f}"]
            for p in record.poses
        ],
    )
    page.section("Record")
    page.definitions(_origin(record, signature))
    return page.text()


def _result(record: CalibrationRecord) -> dict[str, str]:
    pendant = HALF_TURN @ record.pose
    sigma = np.sqrt(np.diag(np.array(record.covariance)))
    scale, sigma_scale = record.board_scale
    first, second = np.rad2deg(record.rotations)
    return {
        "X_base_camera": f"{pose_text(record.pose)}, in base_link",
        "in the pendant's Base": pose_text(pendant),
        "standard deviations": f"position {_triple(sigma[:3] * 1e3)} mm, rotation {_triple(np.rad2deg(sigma[3:]))}°",
        "noise of the corners": f"{record.pixel_noise:.2f} px",
        "noise of the arm": f"{record.arm_noise[0] * 1e3:.2f} mm, {np.rad2deg(record.arm_noise[1]):.3f}°",
        "rotations": f"{first:.0f}° at most, {second:.0f}° about an axis across it; 25° are needed",
        "board by the arm's motions": f"{scale * record.board.square * 1e3:.3f} ± "
        f"{2 * sigma_scale * record.board.square * 1e3:.3f} mm a square, measured {record.board.square * 1e3:.3f} mm",
    }


def _origin(record: CalibrationRecord, signature: str) -> dict[str, str]:
    K, board = record.intrinsics, record.board
    bars = "" if record.bars is None else f", bars {record.bars[0] * 1e3:.2f} and {record.bars[1] * 1e3:.2f} mm"
    lens = "" if record.distortion is None else f", distortion {[round(v, 5) for v in record.distortion]}"
    kinematics = "factory calibration of the station file" if record.kinematics else "nominal, or poses as given"
    return {
        "intrinsics": f"{K.width} × {K.height} px, fx {K.fx:.2f}, fy {K.fy:.2f}, cx {K.cx:.2f}, cy {K.cy:.2f}{lens}",
        "board": f"{board.columns} × {board.rows} squares of {board.square * 1e3:.3f} mm, {board.dictionary}{bars}",
        "board's fingerprint": board.fingerprint,
        "kinematics": kinematics,
        "software": record.software,
        "signature": signature,
    }


def _region(record: CalibrationRecord, distance: float) -> list[str]:
    covariance = point_covariance(np.array(record.covariance), record.pose, np.array([0.0, 0.0, distance]))
    axes = np.sqrt(confidence_factor(record.freedom) * np.linalg.eigvalsh(covariance))
    return [f"{distance:g} m", _triple(axes[::-1] * 1e3)]


def _triple(values: NDArray[np.float64]) -> str:
    return ", ".join(f"{v:.3f}" for v in values)


def _png(figure: Figure) -> bytes:
    FigureCanvasAgg(figure)
    file = BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return file.getvalue()


def _bars(record: CalibrationRecord) -> bytes:
    with matplotlib.rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(9.0, 3.6), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True)
        at = np.arange(len(record.poses))
        colors = [_BLUE if p.weight > 0.5 else _ORANGE for p in record.poses]
        upper.bar(at, [p.held_out * 1e3 for p in record.poses], color=colors)
        upper.axhline(record.residual * 1e3, color="black", linewidth=0.6)
        upper.set_ylabel("held out, mm")
        lower.bar(at, [p.reprojection for p in record.poses], color=colors)
        lower.set_ylabel("reprojection, px")
        lower.set_xticks(at, [Path(p.name).stem for p in record.poses], rotation=60)
        return _png(figure)


def _coverage(record: CalibrationRecord) -> bytes:
    K = record.intrinsics
    with matplotlib.rc_context({"font.size": 8}):
        figure = Figure(figsize=(5.0, 5.0 * K.height / K.width), layout="constrained")
        axes = figure.subplots()
        for pose in record.poses:
            u, v = np.array(pose.pixels).T
            axes.plot(u, v, ".", markersize=3)
        axes.set_xlim(0, K.width)
        axes.set_ylim(K.height, 0)
        axes.set_aspect("equal")
        return _png(figure)


def _contact_sheet(record: CalibrationRecord, folder: Path) -> bytes | None:
    tiles = []
    for pose in record.poses:
        try:
            image = read_image(folder / pose.name, cv2.IMREAD_COLOR)
        except (OSError, ValueError):  # the calibration goes without: it was moved or damaged since
            image = None
        if image is None:
            continue
        for u, v in pose.pixels:
            cv2.circle(image, (round(u), round(v)), 3, (27, 85, 200), 1, cv2.LINE_AA)
        height = round(_THUMBNAIL * image.shape[0] / image.shape[1])
        tiles.append(cv2.resize(image, (_THUMBNAIL, height), interpolation=cv2.INTER_AREA))
    if not tiles:
        return None
    blank = np.full_like(tiles[0], 255)
    tiles.extend([blank] * (-len(tiles) % _ACROSS))
    lines = [np.hstack(tiles[i : i + _ACROSS]) for i in range(0, len(tiles), _ACROSS)]
    done, png = cv2.imencode(".png", np.vstack(lines))
    return png.tobytes() if done else None
