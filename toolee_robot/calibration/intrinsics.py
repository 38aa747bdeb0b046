"""The intrinsics of a camera from views of a board, with their uncertainty and a held-out error."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress
from pathlib import Path

import cv2
import numpy as np

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.observation import MIN_CORNERS, BoardView, find_board
from toolee_robot.calibration.record import INTRINSICS_FORMAT, IntrinsicsRecord
from toolee_robot.errors import UserError, words_of
from toolee_robot.frames import Array
from toolee_robot.runtime.images import read_image
from toolee_robot.types import CameraIntrinsics

MIN_VIEWS = 10
"""Fewest views of the board."""
FOCAL_ERROR = 0.003
"""Standard deviation of a focal length, relative, above which the views do not determine it."""
CELLS = 4
"""Parts of the image along each edge in which corners are counted."""
COVERED = 0.6
"""Least share of the parts that have corners: the distortion is extrapolated elsewhere."""
OUTLIER = 3.4
"""Multiple of the median error above which a corner does not fit the others: four standard deviations."""
LARGEST_LEFT_OUT = 0.1
"""Share of the corners that do not fit the others above which it is the model that does not fit. Assumed."""
FITTING = 0.3
"""Error of a corner that always fits [px]."""
LARGEST_HELD_OUT = 1.0
"""Reprojection error on held-out views above which the model does not fit [px]."""
DISTORTED_FLAT = 4.0
"""Tolerance of `find_board` for images of a distorting lens [px]."""
PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
"""Endings of files that are images."""
_MISFIT = "a bent board, motion while the image was taken, or a lens that four numbers do not describe"
_FOLDS = 5
_ROUNDS = 3


def read_views(folder: Path, board: Board) -> tuple[list[BoardView], list[str], tuple[int, int]]:
    """Find the board in all images of a folder; 16 bit ones, which are depth images, are left out.

    Args:
        folder: The folder.
        board: The board.

    Returns:
        The views; names of the images without the board; width and height of the images [px].

    Raises:
        UserError: There is no such folder or no image in it, or the images have several sizes
           .
    """
    views: list[BoardView] = []
    unseen: list[str] = []
    size: tuple[int, int] | None = None
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        try:
            image = read_image(path) if path.suffix.lower() in PICTURES else None
        except (OSError, ValueError) as error:
            raise UserError(f"cannot read the image {path}: {words_of(error)}") from error
        if image is None or image.dtype != np.uint8:
            continue
        grey = np.asarray(image if image.ndim == 2 else cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY), np.uint8)
        mine = (grey.shape[1], grey.shape[0])
        if size not in (None, mine):
            raise UserError(f"{path} is {mine}, others are {size} pixels: give images of one size")
        size = mine
        view = find_board(grey, board, DISTORTED_FLAT)
        if view is None:
            unseen.append(path.name)
        else:
            views.append(view)
    if size is None:
        raise UserError(f"{folder} has no images: name a folder of PNG or JPEG files")
    return views, unseen, size


def calibrate_intrinsics(
    views: Sequence[BoardView],
    board: Board,
    size: tuple[int, int],
    *,
    camera_serial: str,
    software: str,
    measured_at: str,
) -> IntrinsicsRecord:
    """Calibrate a camera's intrinsics (Zhang, 2000, by OpenCV).

    Corners that do not fit the others, such as those that the image's edge cuts, are left out.

    Args:
        views: Views of the board, tilted in different ways, all over the image.
        board: The board with its measured square.
        size: Width and height of the images [px].
        camera_serial: Serial number of the camera.
        software: Version of this software.
        measured_at: Date and time, ISO 8601.

    Returns:
        The record.

    Raises:
        UserError: There are too few views, they leave out most of the image or do not determine the focal length, or
            the model does not fit held-out views, or too many corners.
    """
    if len(views) < MIN_VIEWS:
        raise UserError(f"{len(views)} images show the board: give {MIN_VIEWS} or more, better 30")
    covered = len(covered_parts(views, size)) / CELLS**2
    if covered < COVERED:
        raise UserError(
            f"the board covered {100 * covered:.0f} % of the image, and {100 * COVERED:.0f} % are needed: show it "
            "in the corners, too"
        )
    corners = sum(len(view.ids) for view in views)
    views = _fitting(views, board, size)
    left_out = corners - sum(len(view.ids) for view in views)
    covered = len(covered_parts(views, size)) / CELLS**2
    if left_out > LARGEST_LEFT_OUT * corners or covered < COVERED or len(views) < MIN_VIEWS:
        raise UserError(
            f"{left_out} of {corners} corners do not fit the others; {len(views)} views remain, on {100 * covered:.0f} "
            f"% of the image: {_MISFIT}"
        )
    error, K, distortion, sigma = _fit(views, board, size)
    held_out = _held_out(views, board, size)
    if held_out > LARGEST_HELD_OUT:
        raise UserError(f"views that took no part are {held_out:.2f} px off: {_MISFIT}")
    relative = float(max(sigma[0] / K[0, 0], sigma[1] / K[1, 1]))
    if relative > FOCAL_ERROR:
        raise UserError(
            f"the focal length is uncertain by {100 * relative:.1f} %. Tilt the board by 30 to 45° in most views; a "
            "board that faces the camera does not help"
        )
    width, height = size
    return IntrinsicsRecord(
        format=INTRINSICS_FORMAT,
        measured_at=measured_at,
        software=software,
        camera_serial=camera_serial,
        board=board,
        intrinsics=CameraIntrinsics(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), width, height),
        distortion=tuple(float(v) for v in distortion),
        sigma=tuple(float(v) for v in sigma[:4]),
        sigma_distortion=tuple(float(v) for v in sigma[4:8]),
        reprojection=error,
        held_out=held_out,
        largest_distortion=_largest_distortion(views, K, distortion),
        covered=covered,
        views=len(views),
        left_out=left_out,
    )


def covered_parts(views: Sequence[BoardView], size: tuple[int, int]) -> set[tuple[int, int]]:
    """Tell in which parts of the image corners were seen.

    Args:
        views: Views of the board.
        size: Width and height of the images [px].

    Returns:
        Column and row of each part that has corners, of CELLS x CELLS.
    """
    return {(int(u * CELLS / size[0]), int(v * CELLS / size[1])) for view in views for u, v in view.pixels}


def _fit(views: Sequence[BoardView], board: Board, size: tuple[int, int]) -> tuple[float, Array, Array, Array]:
    corners = board.corners.astype(np.float32)
    error, K, distortion, _, _, sigma, _, _ = cv2.calibrateCameraExtended(
        [corners[v.ids] for v in views],
        [v.pixels.astype(np.float32) for v in views],
        size,
        None,
        None,
        flags=cv2.CALIB_FIX_K3,
    )  # type: ignore[call-overload]
    return float(error), np.asarray(K), np.asarray(distortion).ravel()[:4], np.asarray(sigma).ravel()


def _fitting(views: Sequence[BoardView], board: Board, size: tuple[int, int]) -> list[BoardView]:
    """The views without corners that do not fit the others; what they pulled aside comes back."""
    whole, kept = list(views), list(views)
    for _ in range(_ROUNDS):
        _, K, distortion, _ = _fit(kept, board, size)
        errors = [
            np.linalg.norm(_residuals(view, board, K, distortion, by), axis=1)
            for view, by in zip(whole, kept, strict=True)
        ]
        most = max(FITTING, OUTLIER * float(np.median(np.concatenate(errors))))
        fits = [BoardView(v.ids[e <= most], v.pixels[e <= most]) for v, e in zip(whole, errors, strict=True)]
        enough = [len(view.ids) >= MIN_CORNERS for view in fits]
        whole, kept = (list(compress(some, enough)) for some in (whole, fits))
        if len(kept) < MIN_VIEWS:
            break
    return kept


def _residuals(view: BoardView, board: Board, K: Array, distortion: Array, by: BoardView | None = None) -> Array:
    """Errors of a view's corners with the board where `by`, a part of the view, has it, (N, 2) [px]."""
    part = view if by is None else by
    _, rotation, translation = cv2.solvePnP(board.corners[part.ids], part.pixels, K, distortion)
    pixels, _ = cv2.projectPoints(board.corners[view.ids], rotation, translation, K, distortion)
    return np.asarray(pixels.reshape(-1, 2) - view.pixels)


def _held_out(views: Sequence[BoardView], board: Board, size: tuple[int, int]) -> float:
    squares, count = 0.0, 0
    for fold in range(_FOLDS):
        _, K, distortion, _ = _fit([v for i, v in enumerate(views) if i % _FOLDS != fold], board, size)
        for view in views[fold::_FOLDS]:
            squares += float(np.sum(_residuals(view, board, K, distortion) ** 2))
            count += len(view.ids)
    return float(np.sqrt(squares / count))


def _largest_distortion(views: Sequence[BoardView], K: Array, distortion: Array) -> float:
    pixels = np.concatenate([view.pixels for view in views])
    ideal = cv2.undistortPoints(pixels.reshape(-1, 1, 2), K, distortion, P=K).reshape(-1, 2)
    return float(np.linalg.norm(ideal - pixels, axis=1).max())
