"""Synthetic calibrations with a known truth, for the benchmark and the tests: poses, corners and their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.hand_eye.refinement import SQUARE_ERROR
from toolee_robot.calibration.observation import MIN_CORNERS, BoardView, Observation
from toolee_robot.frames import Array, inverse, transform, transform_points
from toolee_robot.types import CameraIntrinsics

_DISTANCE = (0.55, 0.95)
"""Distance of the board from the camera [m]."""
_MARGIN = 3.0
"""Distance of a corner that is seen from the image's edge [px]."""


@dataclass(frozen=True)
class Protocol:
    """How the poses are drawn, and the noise, each a standard deviation about one axis.

    Attributes:
        poses: Number of poses.
        tilt: Largest rotation of the board off facing the camera, and about its normal [rad].
        position: Noise of the arm's position [m].
        rotation: Noise of the arm's rotation [rad].
        pixel: Noise of a corner [px].
        square_error: Noise of the board's measured square, relative.
        scale: True scale of the board, relative to what is believed, before that noise.
        outliers: Poses of which the arm's pose is wrong by 20 mm and 3 deg.
    """

    poses: int = 15
    tilt: float = float(np.deg2rad(35.0))
    position: float = 3e-4
    rotation: float = float(np.deg2rad(0.03))
    pixel: float = 0.2
    square_error: float = SQUARE_ERROR
    scale: float = 1.0
    outliers: int = 0


@dataclass(frozen=True, eq=False)
class SyntheticSet:
    """A drawn set and its truth.

    Attributes:
        observations: What a calibration gets.
        X_base_camera: True pose of the camera, (4, 4).
        X_flange_board: True pose of the board, (4, 4).
    """

    observations: list[Observation]
    X_base_camera: Array
    X_flange_board: Array


def draw(
    protocol: Protocol, board: Board, intrinsics: CameraIntrinsics, X_base_camera: Array, rng: np.random.Generator
) -> SyntheticSet:
    """Draw a set of observations.

    Args:
        protocol: Poses and noise.
        board: The board as it is believed to be.
        intrinsics: Pinhole model of the image.
        X_base_camera: True pose of the camera, (4, 4).
        rng: Source of randomness.

    Returns:
        The set.
    """
    X_flange_board = transform(
        Rotation.from_rotvec(rng.uniform(-0.3, 0.3, 3)) * Rotation.from_euler("x", 180, degrees=True),
        [-board.size[0] / 2 + rng.uniform(-0.05, 0.05), board.size[1] / 2 + rng.uniform(-0.05, 0.05), 0.12],
    )
    observations: list[Observation] = []
    corners = protocol.scale * (1.0 + rng.normal(0.0, protocol.square_error)) * board.corners
    while len(observations) < protocol.poses:
        X_camera_board = _board_before_camera(protocol, board, intrinsics, rng)
        pixels = intrinsics.project(transform_points(X_camera_board, corners))
        edge = np.array([intrinsics.width, intrinsics.height]) - 1 - _MARGIN
        seen = np.flatnonzero(np.all((pixels > _MARGIN) & (pixels < edge), axis=1))
        if len(seen) < max(MIN_CORNERS, len(corners) // 2):
            continue
        X = X_base_camera @ X_camera_board @ inverse(X_flange_board)
        wrong = len(observations) < protocol.outliers
        error = np.concatenate([rng.normal(0, protocol.position, 3), rng.normal(0, protocol.rotation, 3)])
        if wrong:
            error += np.concatenate([rng.normal(0, 0.02, 3), rng.normal(0, np.deg2rad(3), 3)])
        X = transform(Rotation.from_rotvec(error[3:]).as_matrix() @ X[:3, :3], X[:3, 3] + error[:3])
        noisy = pixels[seen] + rng.normal(0, protocol.pixel, (len(seen), 2))
        observations.append(Observation(f"{len(observations):03d}", X, BoardView(seen, noisy)))
    return SyntheticSet(observations, X_base_camera, X_flange_board)


def _board_before_camera(
    protocol: Protocol, board: Board, intrinsics: CameraIntrinsics, rng: np.random.Generator
) -> Array:
    """X_camera_board of a board somewhere in the image, (4, 4)."""
    depth = rng.uniform(*_DISTANCE)
    u, v = rng.uniform(0.2, 0.8) * intrinsics.width, rng.uniform(0.2, 0.8) * intrinsics.height
    center = depth * intrinsics.rays(np.array([u, v]))
    direction = rng.uniform(0, 2 * np.pi)
    across = np.array([np.cos(direction), np.sin(direction), 0.0]) * rng.uniform(-protocol.tilt, protocol.tilt)
    about = np.array([0.0, 0.0, rng.uniform(-protocol.tilt, protocol.tilt)])
    R = Rotation.from_rotvec(across) * Rotation.from_rotvec(about)
    return transform(R, center - R.as_matrix() @ board.center)
