"""The measurement model of a board on the flange, the closed form that starts from it, and the motion that it needs.

With the camera fixed and the board on the flange, X_camera_board = X_base_camera^-1 X_base_flange X_flange_board.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.observation import Observation
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, inverse, is_rigid, skew, transform
from toolee_robot.types import CameraIntrinsics

CAMERA, BOARD, SCALE = slice(0, 6), slice(6, 12), 12
"""Places of the camera's pose, the board's pose and the board's scale in a step."""
_NEAREST = 0.05
"""Depth at which a corner behind the camera is taken to be, so that a bad start has a finite residual [m]."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a calibration determines.

    Attributes:
        X_base_camera: Pose of the camera, (4, 4).
        X_flange_board: Pose of the board, (4, 4).
        scale: Factor on the board's measured square.
    """

    X_base_camera: Array
    X_flange_board: Array
    scale: float = 1.0

    def moved(self, step: Array) -> Estimate:
        """Apply a step.

        Args:
            step: Translation [m] and rotation vector [rad] of the camera in the axes of `base`, those of the board in
                the axes of the flange, and the change of the scale, (13,).

        Returns:
            The estimate after it.
        """
        camera, board = _moved(self.X_base_camera, step[CAMERA]), _moved(self.X_flange_board, step[BOARD])
        return Estimate(camera, board, self.scale + float(step[SCALE]))


def _moved(X: Array, step: Array) -> Array:
    return transform(Rotation.from_rotvec(step[3:6]).as_matrix() @ X[:3, :3], X[:3, 3] + step[:3])


@dataclass(frozen=True, eq=False)
class Projection:
    """Residuals of all views at an estimate, and their derivatives; views of fewer corners are padded with zeros.

    Attributes:
        residuals: Projected minus measured corners, (N, 2 M) [px].
        by_parameters: Derivatives by a step of the estimate, (N, 2 M, 13).
        by_flange: Derivatives by an error of the flange's position [m] and rotation vector [rad], axes of `base`,
            (N, 2 M, 6).
    """

    residuals: Array
    by_parameters: Array
    by_flange: Array


class Views:
    """The observations as padded arrays.

    Args:
        observations: The observations.
        board: The board.
        intrinsics: Pinhole model of the images.

    Attributes:
        count: Corners of each view, (N,).
        Xs_base_flange: Poses of the flange, (N, 4, 4).
    """

    def __init__(self, observations: Sequence[Observation], board: Board, intrinsics: CameraIntrinsics) -> None:
        self.count = np.array([len(o.view.ids) for o in observations])
        self.Xs_base_flange = np.array([o.X_base_flange for o in observations])
        self._K = intrinsics
        most = int(self.count.max())
        self._valid = np.arange(most) < self.count[:, None]
        self._points = np.zeros((len(observations), most, 3))
        self._pixels = np.zeros((len(observations), most, 2))
        corners = board.corners
        for i, o in enumerate(observations):
            self._points[i, : self.count[i]] = corners[o.view.ids]
            self._pixels[i, : self.count[i]] = o.view.pixels

    def project(self, estimate: Estimate) -> Projection:
        """Project the corners.

        Args:
            estimate: The estimate.

        Returns:
            Residuals and derivatives.
        """
        n, m = self._valid.shape
        Rc, pc = estimate.X_base_camera[:3, :3], estimate.X_base_camera[:3, 3]
        Rb, pb = estimate.X_flange_board[:3, :3], estimate.X_flange_board[:3, 3]
        Rf, pf = self.Xs_base_flange[:, :3, :3], self.Xs_base_flange[:, :3, 3]
        turned = self._points @ Rb.T  # in the axes of the flange, unscaled
        about_flange = (estimate.scale * turned + pb) @ np.swapaxes(Rf, 1, 2)  # base axes, from the flange's origin
        about_camera = about_flange + (pf - pc)[:, None]
        x, y, z = np.moveaxis(about_camera @ Rc, 2, 0)
        z = np.where(self._valid, np.maximum(z, _NEAREST), 1.0)
        K = self._K
        u, v = K.fx * x / z + K.cx, K.fy * y / z + K.cy
        residuals = np.stack([u, v], axis=2) - self._pixels
        D = np.zeros((n, m, 2, 3))  # of the pixel by the point, camera axes
        D[..., 0, 0], D[..., 0, 2] = K.fx / z, -K.fx * x / z**2
        D[..., 1, 1], D[..., 1, 2] = K.fy / z, -K.fy * y / z**2
        D = D @ Rc.T  # by the point in base axes
        D_flange = D @ Rf[:, None]
        by_parameters = np.concatenate(
            [
                -D,
                D @ skew(about_camera),
                D_flange,
                -D_flange @ skew(estimate.scale * turned),
                D_flange @ turned[..., None],
            ],
            axis=3,
        )
        by_flange = np.concatenate([D, -D @ skew(about_flange)], axis=3)
        keep = self._valid[..., None]
        return Projection(
            (residuals * keep).reshape(n, 2 * m),
            (by_parameters * keep[..., None]).reshape(n, 2 * m, 13),
            (by_flange * keep[..., None]).reshape(n, 2 * m, 6),
        )


METHOD = "Horaud"


def closed_form(Xs_base_flange: Sequence[Array], Xs_camera_board: Sequence[Array]) -> Estimate | None:
    """Calibrate in closed form.

    Args:
        Xs_base_flange: Poses of the flange, (4, 4) each.
        Xs_camera_board: Poses of the board at the same times, (4, 4) each.

    Returns:
        Camera and board; None if the method fails on these poses.
    """
    flange, board = np.asarray(Xs_base_flange), np.asarray(Xs_camera_board)
    back = inverse(flange)
    rotations, positions = [list(X[:, :3, :3]) for X in (back, board)], [list(X[:, :3, 3]) for X in (back, board)]
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        R, p = cv2.calibrateHandEye(
            rotations[0], positions[0], rotations[1], positions[1], method=cv2.CALIB_HAND_EYE_HORAUD
        )
    except cv2.error:
        return None
    finally:
        cv2.utils.logging.setLogLevel(level)
    X_base_camera = transform(R, np.asarray(p).ravel())
    return Estimate(X_base_camera, mean_pose(back @ X_base_camera @ board)) if is_rigid(X_base_camera, 1e-4) else None


def mean_pose(Xs: Array) -> Array:
    """Average poses, (N, 4, 4): the median of the positions, and the chordal mean of the rotations."""
    U, _, Vt = np.linalg.svd(Xs[:, :3, :3].sum(axis=0))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return transform(R, np.median(Xs[:, :3, 3], axis=0))


MIN_POSES = 8
"""Fewest poses of a calibration."""
MIN_ROTATION = np.deg2rad(25.0)
"""Least rotation between two poses, about each of two axes at right angles to each other [rad]."""


@dataclass(frozen=True, eq=False)
class MotionSpread:
    """Rotations between the poses of the flange.

    Attributes:
        first: Largest rotation between two poses [rad].
        second: Largest rotation between two poses about an axis at a right angle to that one's [rad]: the part of
            their rotation vector there.
    """

    first: float
    second: float

    @property
    def sufficient(self) -> bool:
        """Whether both rotations are large enough."""
        return min(self.first, self.second) >= MIN_ROTATION


def motion_spread(Xs_base_flange: Sequence[Array]) -> MotionSpread:
    """Measure the rotations between poses.

    The translation of a hand-eye calibration is undetermined along the axis of all rotations where they share one
    (Tsai and Lenz, 1989).

    Args:
        Xs_base_flange: Poses of the flange, (4, 4) each, two or more.

    Returns:
        The rotations.
    """
    R = Rotation.from_matrix(np.asarray(Xs_base_flange)[:, :3, :3])
    i, j = np.triu_indices(len(Xs_base_flange), 1)
    vectors = (R[i].inv() * R[j]).as_rotvec()
    angles = np.linalg.norm(vectors, axis=1)
    largest = int(np.argmax(angles))
    axis = vectors[largest] / max(angles[largest], 1e-12)
    across = vectors - np.outer(vectors @ axis, axis)
    return MotionSpread(float(angles[largest]), float(np.linalg.norm(across, axis=1).max()))


def check_motion(Xs_base_flange: Sequence[Array]) -> MotionSpread:
    """Refuse poses that do not determine a calibration.

    Args:
        Xs_base_flange: Poses of the flange, (4, 4) each.

    Returns:
        The rotations between them.

    Raises:
        UserError: There are too few, or they turn the board too little or about one axis only.
    """
    if len(Xs_base_flange) < MIN_POSES:
        raise UserError(f"{len(Xs_base_flange)} poses show the board: give {MIN_POSES} or more, better 20")
    spread = motion_spread(Xs_base_flange)
    if not spread.sufficient:
        raise UserError(
            f"the poses turn the board by at most {np.rad2deg(spread.first):.0f}° about one axis and "
            f"{np.rad2deg(spread.second):.0f}° about any axis across it. Both need {np.rad2deg(MIN_ROTATION):.0f}°. "
            "Tilt the board left, right, up and down, and turn it"
        )
    return spread
