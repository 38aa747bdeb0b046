"""The closed-form hand-eye calibration that starts the refinement.

With the camera fixed and the board on the flange, X_camera_board = X_base_camera^-1 X_base_flange X_flange_board.
Of OpenCV's six methods it takes Park's: from each of them the refinement ends at the same place, in 100 of 100
synthetic sets of `benchmarks.calibration` with tilts over 10 deg and under, exact or coarse arms, and wrong poses.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from toolee_robot.calibration.hand_eye.reprojection import Estimate
from toolee_robot.frames import Array, inverse, is_rigid, transform

METHOD = "Park"


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
