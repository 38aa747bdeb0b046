"""The place of a nail and the plane of the wood, by the camera and a board on the wood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.observation import find_board
from toolee_robot.calibration.touches import KnownCamera, see_board
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, angle_between, transform_points

LARGEST_TILT = float(np.deg2rad(5.0))
"""Tilt of a board beyond which it does not lie on the wood [rad]: a block on its stand is straighter."""
LARGEST_SCALING = 0.03
"""Deviation of the board's distance in the depth image from that by its size beyond which its size is wrong."""
FEWEST_DEPTHS = 30
"""Fewest pixels of the board with a depth for that comparison."""


@dataclass(frozen=True)
class OnWood:
    """How a board lies on the wood, with the standard deviations of a person's measurement.

    Attributes:
        p_board_nail: Place of the nail's axis in the board's frame, x and y [m].
        thickness: Height of the printed plane over the wood [m].
        placing_error: Standard deviation of the nail's place on the board about each axis [m].
        thickness_error: Standard deviation of the height [m].
    """

    p_board_nail: tuple[float, float]
    thickness: float
    placing_error: float = 5e-4
    thickness_error: float = 1e-4


@dataclass(frozen=True, eq=False)
class SeenNail:
    """Where a nail enters the wood, by the camera.

    Attributes:
        entry: The nail's axis in the plane of the wood, in `base`, (3,) [m].
        covariance: Its covariance by calibration, image, and how the board lies, (3, 3) [m^2].
        up: The wood's normal, away from it, (3,), `base`.
        tilt: Its angle to the vertical [rad].
        tilt_sigma: Standard deviation of each of the two components of the tilt [rad].
        corners: Number of the board's corners that were seen.
        reprojection: Root mean square reprojection error of these [px].
    """

    entry: Array
    covariance: Array
    up: Array
    tilt: float
    tilt_sigma: float
    corners: int
    reprojection: float


def see_nail(
    camera: KnownCamera,
    board: Board,
    on_wood: OnWood,
    rgb: NDArray[np.uint8],
    depth: NDArray[np.float32] | None = None,
) -> SeenNail:
    """Locate the nail by an image of a board on the wood.

    Args:
        camera: The calibrated camera.
        board: The board with its measured square.
        on_wood: How it lies.
        rgb: The image, (H, W, 3) uint8, or grey.
        depth: The depth image, registered to it, (H, W) [m], 0 or NaN where unknown; None where there is none: a wrong
            size of the board is then not noticed.

    Returns:
        The nail.

    Raises:
        UserError: The board is not seen, or so that its tilt is ambiguous; it has another size, or lies on
            no upright block's top.
    """
    view = find_board(rgb, board)
    if view is None:
        raise UserError(
            "no board is seen in the image. Check --sheet, and that the board is whole, flat, well lit and near"
        )
    seen = see_board(camera, board, view, rgb)
    if depth is not None:
        _check_size(seen.X_camera_board, board, camera, depth)
    X = seen.X_base_board
    up = -X[:3, 2]
    tilt = angle_between(up, np.array([0.0, 0.0, 1.0]))
    if tilt > LARGEST_TILT:
        raise UserError(
            f"the board is tilted by {np.rad2deg(tilt):.1f}°, and {np.rad2deg(LARGEST_TILT):.0f} are allowed. Lay "
            "it flat on the wood, level the wood, or check the camera's calibration (`toolee calibrate check`)"
        )
    p_board = np.array([*on_wood.p_board_nail, on_wood.thickness])
    entry, covariance = seen.point(p_board)
    by_person = np.diag([on_wood.placing_error, on_wood.placing_error, on_wood.thickness_error]) ** 2
    covariance = covariance + X[:3, :3] @ by_person @ X[:3, :3].T
    tilt_sigma = float(np.sqrt(np.trace(seen.rotation()[:2, :2]) / 2))
    return SeenNail(entry, covariance, up, tilt, tilt_sigma, len(view.ids), seen.reprojection)


def _check_size(X_camera_board: Array, board: Board, camera: KnownCamera, depth: NDArray[np.float32]) -> None:
    """Compare the distance of the board by its size with that in the depth image."""
    k = camera.intrinsics
    width, height = board.size
    x, y = np.meshgrid(np.linspace(0.02, 0.98, 40) * width, np.linspace(0.02, 0.98, 40) * height)
    points = transform_points(X_camera_board, np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))
    u, v = np.rint(k.project(points)).astype(int).T
    inside = (u >= 0) & (u < k.width) & (v >= 0) & (v < k.height)
    measured = depth[v[inside], u[inside]]
    known = np.isfinite(measured) & (measured > 0.0)
    if np.count_nonzero(known) < FEWEST_DEPTHS:
        return
    ratio = float(np.median(measured[known] / points[inside, 2][known]))
    if abs(ratio - 1.0) > LARGEST_SCALING:
        raise UserError(
            f"the board's size puts it {points[:, 2].mean():.3f} m away, the depth image {ratio:.3f} times as far. "
            f"Its squares seem to be {ratio * board.square * 1e3:.1f} mm, not {board.square * 1e3:.1f}. Check "
            "--sheet, and measure both scale bars again"
        )
