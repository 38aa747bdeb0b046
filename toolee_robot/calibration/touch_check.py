"""The touch test: a corner of a board that took no part in the calibration, measured by the camera and by the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.board_sight import KnownCamera, see_board
from toolee_robot.calibration.hand_eye.refinement import confidence_factor
from toolee_robot.calibration.observation import BoardView
from toolee_robot.calibration.record import CalibrationRecord, TouchCheck
from toolee_robot.errors import UserError
from toolee_robot.frames import HALF_TURN, Array


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
        raise UserError(
            f"corner {corner}: the board has the corners 0 to {len(board.corners) - 1}", code="user.board_corner"
        )
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
            "The two agree after half a turn about the base's z: the touched place is in the other frame of the base; "
            "look at --frame"
        )
    if np.linalg.norm(touched) > 10.0:
        return "The touched place is no metres."
    return (
        "Has the camera or its mount moved? Is the TCP the tip that touched? Is the square of this board measured? "
        "Otherwise calibrate again."
    )
