"""What is seen and what is touched: a tip on the flange, a board that lies still, and the test of one by the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.hand_eye.refinement import SQUARE_ERROR, confidence_factor, point_covariance
from toolee_robot.calibration.hand_eye.reprojection import MIN_ROTATION, Estimate, Views, motion_spread
from toolee_robot.calibration.observation import BoardView, Observation, align, camera_board
from toolee_robot.calibration.record import CalibrationRecord, Row, TouchCheck
from toolee_robot.errors import UserError
from toolee_robot.frames import HALF_TURN, Array
from toolee_robot.runtime.yaml_files import read_record
from toolee_robot.types import CameraIntrinsics

MIN_TOUCHES = 5
"""Fewest touches: four determine the tip, one more tells whether they agree."""
LARGEST_RESIDUAL = 2e-3
"""Root mean square distance of the tips from their common point above which something has slipped [m]."""


@dataclass(frozen=True)
class Touches:
    """Joint positions at which a tip was on what it touched.

    Attributes:
        touches: Joint positions as the robot reports them, (6,) [rad] each.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012  (read by pydantic, not a field)
    touches: tuple[Row, ...]

    def __post_init__(self) -> None:
        if any(len(q) != 6 for q in self.touches):
            raise ValueError("every touch has six joint positions")


@dataclass(frozen=True, eq=False)
class Tip:
    """A tip on the flange.

    Attributes:
        p_flange_tip: Its place in the flange, (3,) [m].
        p_base_point: Place of the fixed point in `base`, (3,) [m].
        covariance: Covariance of `p_flange_tip`, (3, 3) [m^2].
        residual: Root mean square distance of the tips from the fixed point [m].
        residuals: The distance at each touch, (N,) [m].
    """

    p_flange_tip: Array
    p_base_point: Array
    covariance: Array
    residual: float
    residuals: Array


def read_touches(path: Path) -> Touches:
    """Read a list of touches.

    Args:
        path: A YAML or JSON file.

    Returns:
        The touches.

    Raises:
        ConfigError: It cannot be read, or is no list of six joint positions each.
    """
    return read_record(path, Touches, "list of touches")


def locate_tip(Xs_base_flange: Sequence[Array]) -> Tip:
    """Locate the tip: R_i p_flange_tip + p_i = p_base_point for every touch i, by least squares.

    Args:
        Xs_base_flange: Poses of the flange with the tip on the fixed point, (4, 4) each.

    Returns:
        The tip.

    Raises:
        UserError: There are too few touches, they turn the flange too little, or do not agree.
    """
    if len(Xs_base_flange) < MIN_TOUCHES:
        raise UserError(f"{len(Xs_base_flange)} touches: give {MIN_TOUCHES} or more")
    spread = motion_spread(Xs_base_flange)
    if not spread.sufficient:
        raise UserError(
            f"the touches turn the flange by {np.rad2deg(spread.first):.0f}°, and by "
            f"{np.rad2deg(spread.second):.0f}° about an axis across it. Both need {np.rad2deg(MIN_ROTATION):.0f}°, "
            "or the tip is undetermined along an axis"
        )
    X = np.asarray(Xs_base_flange)
    A = np.concatenate([X[:, :3, :3], np.tile(-np.eye(3), (len(X), 1, 1))], axis=2).reshape(-1, 6)
    solution, *_ = np.linalg.lstsq(A, -X[:, :3, 3].ravel(), rcond=None)
    off = (A @ solution + X[:, :3, 3].ravel()).reshape(-1, 3)
    residuals = np.linalg.norm(off, axis=1)
    residual = float(np.sqrt(np.mean(residuals**2)))
    if residual > LARGEST_RESIDUAL:
        raise UserError(
            f"the touches are {residual * 1e3:.1f} mm apart, touch {int(np.argmax(residuals)) + 1} the most: did the "
            "tip leave the point, or are these another arm's kinematics?"
        )
    variance = float(np.sum(off**2)) / (A.shape[0] - A.shape[1])
    covariance = variance * np.linalg.inv(A.T @ A)[:3, :3]
    return Tip(solution[:3], solution[3:], covariance, residual, residuals)


AMBIGUOUS = 1.5
"""Ratio of the reprojection errors of a board's two possible poses below which its place is not believed."""


@dataclass(frozen=True, eq=False)
class KnownCamera:
    """What a calibration tells of a camera.

    Attributes:
        X_base_camera: Its pose, (4, 4).
        covariance: Covariance of its position [m] and rotation vector [rad], axes of `base`, (6, 6).
        intrinsics: Pinhole model of its images.
        pixel_noise: Standard deviation of a corner's place about one axis [px].
    """

    X_base_camera: Array
    covariance: Array
    intrinsics: CameraIntrinsics
    pixel_noise: float

    @classmethod
    def of_record(cls, record: CalibrationRecord) -> KnownCamera:
        """The camera of a calibration's record."""
        return cls(record.pose, np.array(record.covariance), record.intrinsics, record.pixel_noise)


@dataclass(frozen=True, eq=False)
class SeenBoard:
    """A board in an image of the calibrated camera.

    Attributes:
        camera: The camera.
        X_camera_board: Pose of the board, (4, 4).
        covariance: Covariance of its position [m] and rotation vector [rad] by image and rule, axes of the camera,
            (6, 6).
        reprojection: Root mean square reprojection error of the corners [px].
    """

    camera: KnownCamera
    X_camera_board: Array
    covariance: Array
    reprojection: float

    @property
    def X_base_board(self) -> Array:
        """Pose of the board in `base`, (4, 4)."""
        return self.camera.X_base_camera @ self.X_camera_board

    def point(self, p_board: Array) -> tuple[Array, Array]:
        """Locate a point that is fixed to the board.

        Args:
            p_board: The point in the board's frame, (3,) [m].

        Returns:
            Its place in `base`, (3,) [m], and the covariance by calibration and image, (3, 3) [m^2].
        """
        X, R = self.X_camera_board, self.camera.X_base_camera[:3, :3]
        p_camera = X[:3, :3] @ p_board + X[:3, 3]
        x, y, z = p_camera - X[:3, 3]
        J = np.hstack([np.eye(3), np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])])
        by_camera = point_covariance(self.camera.covariance, self.camera.X_base_camera, p_camera)
        p_base = R @ p_camera + self.camera.X_base_camera[:3, 3]
        return p_base, R @ J @ self.covariance @ J.T @ R.T + by_camera

    def rotation(self) -> Array:
        """Covariance of the board's rotation vector by calibration and image, axes of `base`, (3, 3) [rad^2]."""
        R = self.camera.X_base_camera[:3, :3]
        return np.asarray(R @ self.covariance[3:, 3:] @ R.T + self.camera.covariance[3:, 3:])


def see_board(camera: KnownCamera, board: Board, view: BoardView, image: NDArray[np.uint8] | None = None) -> SeenBoard:
    """Locate a board by one image.

    Args:
        camera: The camera.
        board: The board with its measured square.
        view: The board in the image.
        image: The image, (H, W, 3) uint8 RGB or (H, W): the pose is then refined by the whole of it; None for the
            corners alone.

    Returns:
        The board.

    Raises:
        UserError: It is seen so that its tilt is ambiguous.
    """
    X_camera_board, ratio = camera_board(view, board, camera.intrinsics)
    if ratio < AMBIGUOUS:
        raise UserError(
            "two tilts of the board explain the image almost equally. Lay it nearer to the camera, or turn it so "
            "that the camera sees it more from the side"
        )
    reprojection = view.reprojection(X_camera_board, board, camera.intrinsics)
    # Of an image with more noise than the calibration's had, the image itself tells; two numbers a corner, six unknown.
    freedom = max(2 * len(view.ids) - 6, 1)
    noise = max(camera.pixel_noise, reprojection * np.sqrt(len(view.ids) / freedom))
    # The board's pose in the image as an arm's would be: by_flange is its derivative, with the camera as the base.
    views = Views([Observation("", X_camera_board, view)], board, camera.intrinsics)
    G = views.project(Estimate(np.eye(4), np.eye(4))).by_flange[0]
    covariance = noise**2 * np.linalg.inv(G.T @ G)
    aligned = None if image is None else align(image, board, camera.intrinsics, X_camera_board)
    if aligned is not None:
        X_camera_board, covariance = aligned.X_camera_board, aligned.covariance
        reprojection = view.reprojection(X_camera_board, board, camera.intrinsics)
    # A board of which the squares are measured too large seems to be as much too far away.
    by_rule = np.zeros((6, 6))
    by_rule[:3, :3] = SQUARE_ERROR**2 * np.outer(X_camera_board[:3, 3], X_camera_board[:3, 3])
    return SeenBoard(camera, X_camera_board, covariance + by_rule, reprojection)


@dataclass(frozen=True, eq=False)
class SeenCorner:
    """A corner as the calibrated camera sees it.

    Attributes:
        p_base: Its place in `base`, (3,) [m].
        covariance: Covariance of the place, by the calibration and this image, (3, 3) [m^2].
    """

    p_base: Array
    covariance: Array


def see_corner(record: CalibrationRecord, board: Board, view: BoardView, corner: int) -> SeenCorner:
    """Locate a corner of a board by one image.

    Args:
        record: The camera's calibration.
        board: The board with its measured square; it lies still, not on the flange.
        view: The board in the image.
        corner: Number of the corner.

    Returns:
        The corner's place.

    Raises:
        UserError: The board has no such corner, or is seen so that its tilt is ambiguous.
    """
    if not 0 <= corner < len(board.corners):
        raise UserError(f"corner {corner}: the board has the corners 0 to {len(board.corners) - 1}")
    seen = see_board(KnownCamera.of_record(record), board, view)
    return SeenCorner(*seen.point(board.corners[corner]))


def touch_check(
    record: CalibrationRecord, seen: SeenCorner, touched: Array, touch_error: float, what: str, measured_at: str
) -> TouchCheck:
    """Compare a corner that the camera has seen with the arm's touch of it.

    Args:
        record: The camera's calibration.
        seen: The corner by the camera.
        touched: Its place in `base` by the arm's touch, (3,) [m].
        touch_error: Standard deviation of the touch about one axis [m]: tip, kinematics and eye.
        what: Which corner, for the record.
        measured_at: Date and time, ISO 8601.

    Returns:
        The check. `allowed` is the half axis of the 95 % region of the difference in the direction of the error.
    """
    off = seen.p_base - touched
    error = float(np.linalg.norm(off))
    covariance = seen.covariance + touch_error**2 * np.eye(3)
    direction = off / max(error, 1e-9)
    factor = max(confidence_factor(record.freedom), float(chi2.ppf(0.95, 3)))
    allowed = float(np.sqrt(factor / (direction @ np.linalg.solve(covariance, direction))))
    (a, b, c), (x, y, z) = seen.p_base.tolist(), np.asarray(touched).tolist()
    return TouchCheck(measured_at, what, (a, b, c), (x, y, z), error, allowed)


def cause(check: TouchCheck) -> str:
    """Name what explains a touch that disagrees.

    Args:
        check: The check.

    Returns:
        A sentence; empty where the two agree.
    """
    if check.error <= check.allowed:
        return ""
    seen, touched = np.array(check.seen), np.array(check.touched)
    if np.linalg.norm(HALF_TURN[:3, :3] @ touched - seen) < max(3 * check.allowed, 0.02):
        return (
            "The two agree after half a turn about the base's z: the touched point is in the other frame of the "
            "base. Check --frame"
        )
    if np.linalg.norm(touched) > 10.0:
        return "Give the touched place in metres."
    return (
        "Has the camera or its mount moved? Is the TCP the tip that touched? Is the square of this board measured? "
        "Otherwise calibrate again."
    )
