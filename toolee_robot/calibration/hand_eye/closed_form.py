"""Closed-form hand-eye calibrations, as starting points of the refinement and for comparison.

With the camera fixed and the board on the flange, X_camera_board = X_base_camera^-1 X_base_flange X_flange_board.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from toolee_robot.frames import Array, inverse, is_rigid, transform

HAND_EYE = {
    "Tsai": cv2.CALIB_HAND_EYE_TSAI,
    "Park": cv2.CALIB_HAND_EYE_PARK,
    "Horaud": cv2.CALIB_HAND_EYE_HORAUD,
    "Daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS,
}
"""Methods of `cv2.calibrateHandEye` (A X = X B)."""
ROBOT_WORLD = {"Shah": cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH, "Li": cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI}
"""Methods of `cv2.calibrateRobotWorldHandEye` (A X = Z B)."""


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """Result of one method.

    Attributes:
        method: Name of the method.
        X_base_camera: Pose of the camera, (4, 4).
        X_flange_board: Pose of the board, (4, 4).
    """

    method: str
    X_base_camera: Array
    X_flange_board: Array


def closed_forms(Xs_base_flange: Sequence[Array], Xs_camera_board: Sequence[Array]) -> list[ClosedForm]:
    """Calibrate by every method.

    Args:
        Xs_base_flange: Poses of the flange, (4, 4) each.
        Xs_camera_board: Poses of the board at the same times, (4, 4) each.

    Returns:
        The results; methods that fail on these poses are left out.
    """
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # a method that fails is left out, no more
    try:
        return _closed_forms(Xs_base_flange, Xs_camera_board)
    finally:
        cv2.utils.logging.setLogLevel(level)


def _closed_forms(Xs_base_flange: Sequence[Array], Xs_camera_board: Sequence[Array]) -> list[ClosedForm]:
    found = []
    flange, board = np.asarray(Xs_base_flange), np.asarray(Xs_camera_board)
    back = inverse(flange)
    for method, flag in HAND_EYE.items():
        try:
            R, p = cv2.calibrateHandEye(
                list(back[:, :3, :3]), list(back[:, :3, 3]), list(board[:, :3, :3]), list(board[:, :3, 3]), method=flag
            )
        except cv2.error:
            continue
        X_base_camera = transform(R, np.asarray(p).ravel())
        if is_rigid(X_base_camera, 1e-4):
            found.append(ClosedForm(method, X_base_camera, mean_pose(back @ X_base_camera @ board)))
    for method, flag in ROBOT_WORLD.items():
        try:
            R_board_flange, p_board_flange, R_camera_base, p_camera_base = cv2.calibrateRobotWorldHandEye(
                list(board[:, :3, :3]), list(board[:, :3, 3]), list(flange[:, :3, :3]), list(flange[:, :3, 3]),
                method=flag,
            )  # fmt: skip
        except cv2.error:
            continue
        X_base_camera = inverse(transform(R_camera_base, np.asarray(p_camera_base).ravel()))
        X_flange_board = inverse(transform(R_board_flange, np.asarray(p_board_flange).ravel()))
        if is_rigid(X_base_camera, 1e-4) and is_rigid(X_flange_board, 1e-4):
            found.append(ClosedForm(method, X_base_camera, X_flange_board))
    return found


def mean_pose(Xs: Array) -> Array:
    """Average poses: the median of the positions, and the chordal mean of the rotations.

    Args:
        Xs: Poses, (N, 4, 4).

    Returns:
        The mean pose, (4, 4).
    """
    U, _, Vt = np.linalg.svd(Xs[:, :3, :3].sum(axis=0))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return transform(R, np.median(Xs[:, :3, 3], axis=0))
