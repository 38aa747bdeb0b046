"""What a calibration is computed from: poses of the flange, and the corners of the board that the camera saw there."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.calibration.board import Board
from toolee_robot.frames import Array, transform, transform_points
from toolee_robot.types import CameraIntrinsics

MIN_CORNERS = 8
"""Fewest corners with which a view of the board counts."""
FLAT = 1.0
"""Distance of a corner from a flat board's up to which it is one of it [px]."""
WIDE_ENOUGH = 3
"""Half window of the corner refinement from which on the image itself is wide enough for it [px]."""
SMALLEST_WINDOW = 4
"""Half of the smallest window of the corner refinement in the enlarged image [px]."""
ENLARGED = 2.0
"""Factor by which an image is enlarged before the markers are looked for: theirs are few pixels in a depth camera."""


@dataclass(frozen=True, eq=False)
class BoardView:
    """The board in an image.

    Attributes:
        ids: Numbers of the chessboard corners that were found, (M,).
        pixels: Their places, (M, 2) [px]; pixel centres are at integers.
    """

    ids: NDArray[np.int64]
    pixels: Array

    def without(self, ids: frozenset[int]) -> BoardView:
        """The view without some corners."""
        keep = np.array([int(i) not in ids for i in self.ids], dtype=bool)
        return BoardView(self.ids[keep], self.pixels[keep])

    def reprojection(self, X_camera_board: Array, board: Board, intrinsics: CameraIntrinsics) -> float:
        """Compare the corners with a pose of the board.

        Args:
            X_camera_board: The pose, (4, 4).
            board: The board.
            intrinsics: Pinhole model of the image.

        Returns:
            Root mean square distance of the corners from where the pose has them [px].
        """
        there = intrinsics.project(transform_points(X_camera_board, board.corners[self.ids]))
        return float(np.sqrt(np.mean(np.sum((there - self.pixels) ** 2, axis=1))))


@dataclass(frozen=True, eq=False)
class Observation:
    """One pose of the arm, and what the camera saw there.

    Attributes:
        name: Name of the pose, for messages: the image's file.
        X_base_flange: Pose of the flange, (4, 4) [m].
        view: The board in the image.
        depths: Depth at the corners in the camera's depth image, (M,) [m]; NaN where unknown, None without.
    """

    name: str
    X_base_flange: Array
    view: BoardView
    depths: Array | None = None


def find_board(image: NDArray[np.uint8], board: Board, flat: float = FLAT) -> BoardView | None:
    """Find the corners of a board in an image.

    Args:
        image: Colour, (H, W, 3) uint8 RGB, or grey, (H, W).
        board: The board.
        flat: Distance of a corner from a flat board's up to which it is one of it [px]; larger where the lens distorts.

    Returns:
        The view; None where fewer than `MIN_CORNERS` corners are found.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    large = cv2.resize(grey, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_CUBIC)
    # The board's known layout finds the markers that are too small to be read alone: twice as many at 1 m.
    layout = cv2.aruco.CharucoParameters()
    layout.minMarkers, layout.tryRefineMarkers = 1, True
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board.charuco, layout).detectBoard(large)
    if ids is None or len(ids) < MIN_CORNERS:
        return None
    # cv2.resize aligns the images' outer edges: pixel centres x map to factor * (x + 0.5) - 0.5.
    pixels = (np.asarray(corners, np.float64).reshape(-1, 2) + 0.5) / ENLARGED - 0.5
    window = _refinement_window(pixels)
    # Few pixels bias the corner by a tenth of one, and a larger window has markers in it: enlarge the image.
    factor, smallest = (1.0, WIDE_ENOUGH) if window >= WIDE_ENOUGH else (ENLARGED, SMALLEST_WINDOW)
    half = int(max(factor * window, smallest))
    start = (factor * (pixels + 0.5) - 0.5).astype(np.float32).reshape(-1, 1, 2)
    fine = cv2.cornerSubPix(
        grey if factor == 1.0 else large, start, (half, half), (-1, -1),
        (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3),
    )  # fmt: skip
    places = (np.asarray(fine, np.float64).reshape(-1, 2) + 0.5) / factor - 0.5
    return _flat_part(np.asarray(ids, np.int64).reshape(-1), places, board, flat)


def _flat_part(ids: NDArray[np.int64], pixels: Array, board: Board, flat: float) -> BoardView | None:
    """The view without corners that are no part of a flat board with the others."""
    _, inliers = cv2.findHomography(board.corners[ids, :2], pixels, cv2.RANSAC, flat)
    if inliers is None:
        return None
    keep = inliers.ravel().astype(bool)
    return BoardView(ids[keep], pixels[keep]) if np.count_nonzero(keep) >= MIN_CORNERS else None


def _refinement_window(pixels: Array) -> float:
    """Half window of the corner refinement [px]: an eighth of a square, so that no marker is in it."""
    distances = np.linalg.norm(pixels[:, None] - pixels[None], axis=2)
    np.fill_diagonal(distances, np.inf)
    return float(min(np.median(distances.min(axis=1)) * 0.12, 11.0))


def camera_board(view: BoardView, board: Board, intrinsics: CameraIntrinsics) -> tuple[Array, float]:
    """Compute the pose of a board from one view of it.

    A small board seen from afar has two poses that fit almost equally (Schweighofer and Pinz, 2006); IPPE (Collins and
    Bartoli, 2014) gives both.

    Args:
        view: The view.
        board: The board.
        intrinsics: Pinhole model of the image.

    Returns:
        X_camera_board, (4, 4), the better of the two, refined; and the ratio of the other's reprojection error to its
        own, which is near 1 where they cannot be told apart.
    """
    points = board.corners[view.ids]
    _, rotations, translations, errors = cv2.solvePnPGeneric(
        points, view.pixels, intrinsics.matrix, None, flags=cv2.SOLVEPNP_IPPE
    )
    rotation, translation = cv2.solvePnPRefineLM(
        points, view.pixels, intrinsics.matrix, None, rotations[0], translations[0]
    )
    ratio = float(errors[1].item() / max(errors[0].item(), 1e-9)) if len(errors) > 1 else np.inf
    return transform(cv2.Rodrigues(rotation)[0], np.asarray(translation).ravel()), ratio
