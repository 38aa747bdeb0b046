"""The intrinsics of a camera from views of a board, with their uncertainty and a held-out error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.observation import BoardView, find_board
from toolee_robot.calibration.signed import read_signed, write_signed
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.types import CameraIntrinsics

FORMAT = "toolee camera intrinsics 1"
"""Name and version of the format."""
MIN_VIEWS = 10
"""Fewest views of the board."""
FOCAL_ERROR = 0.003
"""Standard deviation of a focal length, relative, above which the views do not determine it."""
CELLS = 4
"""Parts of the image along each edge in which corners are counted."""
COVERED = 0.6
"""Least share of the parts that have corners: the distortion is extrapolated elsewhere."""
DISTORTED = 0.3
"""Displacement of a pixel by the lens from which on images must be undistorted [px]."""
LARGEST_HELD_OUT = 1.0
"""Reprojection error on held-out views above which the model does not fit [px]."""
DISTORTED_FLAT = 4.0
"""Tolerance of `find_board` for images of a distorting lens [px]."""
PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
"""Endings of files that are images."""
_FOLDS = 5


@dataclass(frozen=True)
class IntrinsicsRecord:
    """Intrinsics, and how far they can be relied on.

    Attributes:
        format: `FORMAT`.
        measured_at: Date and time, ISO 8601.
        software: Version of this software.
        camera_serial: Serial number of the camera.
        board: The board, its square as measured.
        intrinsics: The pinhole model.
        distortion: k1, k2, p1, p2 of OpenCV's model; they hold for images as the camera gives them.
        sigma: Standard deviations of fx, fy, cx, cy [px].
        sigma_distortion: Standard deviations of the distortion.
        reprojection: Root mean square reprojection error of all views [px].
        held_out: The same of views that took no part, each by the others of its fifth left out [px].
        largest_distortion: Largest displacement of a pixel by the lens, in the part of the image that has corners [px].
        covered: Share of the image's parts that have corners.
        views: Number of views.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012  (read by pydantic, not a field)
    format: str
    measured_at: str
    software: str
    camera_serial: str
    board: Board
    intrinsics: CameraIntrinsics
    distortion: tuple[float, ...]
    sigma: tuple[float, ...]
    sigma_distortion: tuple[float, ...]
    reprojection: float
    held_out: float
    largest_distortion: float
    covered: float
    views: int

    def __post_init__(self) -> None:
        if self.format != FORMAT:
            raise ValueError(f"format {self.format!r}: this software reads {FORMAT!r}")

    @property
    def distorts(self) -> bool:
        """Whether images must be undistorted before anything is measured in them."""
        return self.largest_distortion > DISTORTED


def read_views(folder: Path, board: Board) -> tuple[list[BoardView], list[str], tuple[int, int]]:
    """Find the board in all images of a folder; 16 bit ones, which are depth images, are left out.

    Args:
        folder: The folder.
        board: The board.

    Returns:
        The views; names of the images without the board; width and height of the images [px].

    Raises:
        UserError: There is no such folder or no image in it (`user.image`), or the images have several sizes
            (`user.image_size`).
    """
    views: list[BoardView] = []
    unseen: list[str] = []
    size: tuple[int, int] | None = None
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.suffix.lower() in PICTURES else None
        if image is None or image.dtype != np.uint8:
            continue
        grey = np.asarray(image if image.ndim == 2 else cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY), np.uint8)
        mine = (grey.shape[1], grey.shape[0])
        if size not in (None, mine):
            raise UserError(
                f"{path} is {mine}, others are {size} pixels: give images of one size", code="user.image_size"
            )
        size = mine
        view = find_board(grey, board, DISTORTED_FLAT)
        if view is None:
            unseen.append(path.name)
        else:
            views.append(view)
    if size is None:
        raise UserError(f"{folder} has no images: name a folder of PNG or JPEG files", code="user.image")
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
        UserError: There are too few views (`user.intrinsics_few_views`), they leave out most of the image
            (`user.intrinsics_coverage`) or do not determine the focal length (`user.intrinsics_undetermined`), or the
            model does not fit held-out views (`user.intrinsics_misfit`).
    """
    if len(views) < MIN_VIEWS:
        raise UserError(
            f"{len(views)} images show the board: give {MIN_VIEWS} or more, better 30", code="user.intrinsics_few_views"
        )
    covered = _covered(views, size)
    if covered < COVERED:
        raise UserError(
            f"the board was seen in {100 * covered:.0f} % of the image, {100 * COVERED:.0f} % are needed: hold it into "
            "the corners, too",
            code="user.intrinsics_coverage",
        )
    error, K, distortion, sigma = _fit(views, board, size)
    held_out = _held_out(views, board, size)
    if held_out > LARGEST_HELD_OUT:
        raise UserError(
            f"views that took no part are {held_out:.2f} px off: a bent board, motion while the image was taken, or a "
            "lens that four numbers do not describe",
            code="user.intrinsics_misfit",
        )
    relative = float(max(sigma[0] / K[0, 0], sigma[1] / K[1, 1]))
    if relative > FOCAL_ERROR:
        raise UserError(
            f"the focal length is uncertain by {100 * relative:.1f} %: tilt the board by 30 to 45° in most views; a "
            "board that faces the camera tells nothing about it",
            code="user.intrinsics_undetermined",
        )
    width, height = size
    return IntrinsicsRecord(
        format=FORMAT,
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
    )


def write_intrinsics(path: Path, record: IntrinsicsRecord) -> str:
    """Sign and write a record.

    Args:
        path: The file; its folder exists.
        record: The record.

    Returns:
        The signature, hexadecimal.

    Raises:
        UserError: The file cannot be written.
    """
    return write_signed(path, asdict(record))


def read_intrinsics(path: Path) -> IntrinsicsRecord:
    """Read a record and check its signature.

    Args:
        path: The file.

    Returns:
        The record.

    Raises:
        ConfigError: As `read_signed`.
    """
    return read_signed(path, IntrinsicsRecord, "record of intrinsics")


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


def _held_out(views: Sequence[BoardView], board: Board, size: tuple[int, int]) -> float:
    squares, count = 0.0, 0
    for fold in range(_FOLDS):
        _, K, distortion, _ = _fit([v for i, v in enumerate(views) if i % _FOLDS != fold], board, size)
        for view in views[fold::_FOLDS]:
            points = board.corners[view.ids]
            _, rotation, translation = cv2.solvePnP(points, view.pixels, K, distortion)
            pixels, _ = cv2.projectPoints(points, rotation, translation, K, distortion)
            squares += float(np.sum((pixels.reshape(-1, 2) - view.pixels) ** 2))
            count += len(points)
    return float(np.sqrt(squares / count))


def _covered(views: Sequence[BoardView], size: tuple[int, int]) -> float:
    seen = {(int(u * CELLS / size[0]), int(v * CELLS / size[1])) for view in views for u, v in view.pixels}
    return len(seen) / CELLS**2


def _largest_distortion(views: Sequence[BoardView], K: Array, distortion: Array) -> float:
    pixels = np.concatenate([view.pixels for view in views])
    ideal = cv2.undistortPoints(pixels.reshape(-1, 1, 2), K, distortion, P=K).reshape(-1, 2)
    return float(np.linalg.norm(ideal - pixels, axis=1).max())
