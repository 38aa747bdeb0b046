"""Where a board that lies still is in `base`, by one image of the calibrated camera, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.board_image import align
from toolee_robot.calibration.hand_eye.refinement import SQUARE_ERROR, point_covariance
from toolee_robot.calibration.hand_eye.reprojection import Estimate, Views
from toolee_robot.calibration.observation import BoardView, Observation, camera_board
from toolee_robot.calibration.record import CalibrationRecord
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.types import CameraIntrinsics

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
        UserError: It is seen so that its tilt is ambiguous (`user.board_ambiguous`).
    """
    X_camera_board, ratio = camera_board(view, board, camera.intrinsics)
    if ratio < AMBIGUOUS:
        raise UserError(
            "two tilts of the board explain the image almost equally: lay it nearer to the camera, or turn it so that "
            "the camera sees it more from the side",
            code="user.board_ambiguous",
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
