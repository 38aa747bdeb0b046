"""What a calibration is computed from: the corners of a board in an image, and its pose by the whole of its image.

At 1 m a depth camera has 20 pixels for a square, of which the corners use a few. So every edge of squares and markers
counts: the image is predicted from a pose, with pixel size and blur, and compared pixel by pixel (image alignment).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.board import MODULES, Board
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


_SUB = 4
"""Samples of a pixel along each axis."""
_CELLS = 4 * MODULES
"""Pixels along a square of the pattern that is looked up."""
_INSET = 0.25
"""Part of the outer squares that is left out at the edge, beside which it is unknown what is seen."""
_ROUGH = 0.1
"""Difference of intensity beyond which a pixel shows something else, such as the nail [share of black to white]."""
_UNIT, _BLUR, _STEP = 1e-3, 0.6, 0.2
"""Unit of the pose's parameters [m, rad]; blur to start from [px]; step of the numeric derivatives, in these units."""
_SMALLEST = 20
"""Least extent of the board in the image [px]."""
_GAMMA = 2.2
"""Exponent from an image to light, which is what a pixel averages."""
CORRELATED = 4.0
"""Factor on the variance of a pixel's noise for neighbouring pixels being off alike: a lens' and a print's errors."""


@dataclass(frozen=True, eq=False)
class AlignedBoard:
    """A pose by direct alignment.

    Attributes:
        X_camera_board: The pose, (4, 4).
        covariance: Covariance of position [m] and rotation vector [rad], axes of the camera, (6, 6).
    """

    X_camera_board: Array
    covariance: Array


def align(image: NDArray[np.uint8], board: Board, k: CameraIntrinsics, X_camera_board: Array) -> AlignedBoard | None:
    """Refine a pose of a board by its whole image.

    Args:
        image: Colour, (H, W, 3) uint8 RGB, or grey, (H, W).
        board: The board with its measured square.
        k: Pinhole model of the image.
        X_camera_board: The pose to start from, off by a pixel or so, (4, 4).

    Returns:
        The pose; None where too little of the board is in the image.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    low, high = _window(board, k, X_camera_board)
    if np.any(high - low < _SMALLEST):
        return None
    seen = (grey[low[1] : high[1], low[0] : high[0]] / 255.0) ** _GAMMA
    rows, columns = seen.shape
    offsets = (np.arange(_SUB) + 0.5) / _SUB - 0.5
    u = (low[0] + np.arange(columns)[:, None] + offsets).ravel()
    v = (low[1] + np.arange(rows)[:, None] + offsets).ravel()
    rays = np.stack(np.broadcast_arrays((u[None] - k.cx) / k.fx, (v[:, None] - k.cy) / k.fy, 1.0), axis=-1)

    middle = X_camera_board[:3, :3] @ board.center + X_camera_board[:3, 3]

    def pose(step: Array) -> Array:
        """The start, moved by a step and turned by it about the board's middle; in units of `_UNIT`."""
        R = Rotation.from_rotvec(step[3:6] * _UNIT).as_matrix()
        p = middle + step[:3] * _UNIT + R @ (X_camera_board[:3, 3] - middle)
        return transform(R @ X_camera_board[:3, :3], p)

    def on_board(X: Array) -> tuple[Array, Array]:
        """Where the samples' rays meet the board, in squares."""
        along = (X[:3, 2] @ X[:3, 3]) / (rays @ X[:3, 2])
        at = (rays * along[..., None] - X[:3, 3]) @ X[:3, :2] / board.square
        return at[..., 0], at[..., 1]

    x, y = (_mean(c) for c in on_board(X_camera_board))
    inside = (x > _INSET) & (x < board.columns - _INSET) & (y > _INSET) & (y < board.rows - _INSET)
    lit = np.column_stack([np.ones(np.count_nonzero(inside)), x[inside] / board.columns, y[inside] / board.rows])

    def residuals(step: Array) -> Array:
        x, y = on_board(pose(step))
        pattern = map_coordinates(_pattern(board), [y * _CELLS - 0.5, x * _CELLS - 0.5], order=1, mode="nearest")
        blurred = gaussian_filter(_mean(pattern), max(float(step[6]), 0.05))[inside]
        # Light and paper: black and white may change linearly over the board.
        A = np.hstack([lit, lit * blurred[:, None]])
        levels = np.linalg.lstsq(A, seen[inside], rcond=None)[0]
        contrast = max(float(np.mean(lit @ levels[3:])), 1e-3)
        return np.asarray((seen[inside] - A @ levels) / contrast)

    def derivatives(step: Array) -> Array:
        # Central and of one size: the predicted image is rough at the scale of its samples.
        return np.stack([(residuals(step + h) - residuals(step - h)) / (2 * _STEP) for h in _STEP * np.eye(7)], axis=1)

    start = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, _BLUR])
    found = least_squares(residuals, start, derivatives, loss="soft_l1", f_scale=_ROUGH, xtol=1e-4, max_nfev=30)
    X = pose(found.x)
    misfit = float(np.sqrt(np.mean(residuals(found.x) ** 2)))
    information = found.jac.T @ found.jac
    covariance = CORRELATED * misfit**2 * np.linalg.inv(information)[:6, :6] * _UNIT**2
    x, y, z = middle - X[:3, 3]  # the covariance of the middle's place -> that of the origin's
    J = np.eye(6)
    J[:3, 3:] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    return AlignedBoard(X, J @ covariance @ J.T)


def _window(board: Board, k: CameraIntrinsics, X: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Corners of the part of the image that has the board, (2,) each [px]."""
    width, height = board.size
    p = transform_points(X, np.array([[0.0, 0.0, 0.0], [width, 0.0, 0.0], [width, height, 0.0], [0.0, height, 0.0]]))
    pixels = p[:, :2] / p[:, 2:] * [k.fx, k.fy] + [k.cx, k.cy]
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 2, 0)
    return low, np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 3, [k.width, k.height])


def _mean(samples: Array) -> Array:
    """Means over the samples of each pixel."""
    rows, columns = samples.shape
    return np.asarray(samples.reshape(rows // _SUB, _SUB, columns // _SUB, _SUB).mean(axis=(1, 3)))


@lru_cache(maxsize=8)
def _pattern(board: Board) -> Array:
    """The board's drawing, 0 black to 1 white, `_CELLS` pixels a square."""
    size = (board.columns * MODULES, board.rows * MODULES)
    drawn = np.asarray(board.charuco.generateImage(size, marginSize=0)) / 255.0
    return np.asarray(np.kron(drawn, np.ones((_CELLS // MODULES, _CELLS // MODULES))), np.float64)
