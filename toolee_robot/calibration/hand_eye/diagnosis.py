"""The classic mistakes of a hand-eye calibration, told from the data: what does not fit, and what would."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.hand_eye.refinement import Refined
from toolee_robot.calibration.hand_eye.reprojection import closed_form
from toolee_robot.calibration.record import HALF_A_TURN, axes_swapped, camera_is_elsewhere, half_a_turn_apart
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, inverse, is_rigid, transform
from toolee_robot.types import CameraIntrinsics

ARM_POSITION, ARM_ROTATION = 0.005, float(np.deg2rad(0.7))
"""Noise of the arm's poses above which they are not believed: ten times a UR10's [m], [rad]."""
PIXEL = 1.5
"""Noise of the corners above which board or intrinsics are wrong [px]."""
SCALE = 0.004
"""Deviation of the board's scale that the touchdown of a ruler explains."""
SIGMAS = 4.0
"""Standard deviations by which the scale must deviate to be believed."""
LARGEST_REACH = 3.0
"""Distance of a flange from the base above which its unit is not the metre [m]."""
_BETTER = 0.2
"""Misfit with another reading of the poses, relative to that as given, at which that reading is named."""


def check_poses(Xs_base_flange: Sequence[Array], names: Sequence[str]) -> None:
    """Refuse poses that are none, or in millimetres.

    Args:
        Xs_base_flange: Poses of the flange as a person gave them, (4, 4) each.
        names: Their names.

    Raises:
        UserError: A pose is not rigid, or not in metres.
    """
    for X, name in zip(Xs_base_flange, names, strict=True):
        if X.shape != (4, 4) or not is_rigid(X, 1e-4):
            raise UserError(
                f"pose {name}: X_base_flange is not a rigid transform: give 4 x 4, row by row, rotation left and "
                "position right"
            )
        if np.linalg.norm(X[:3, 3]) > LARGEST_REACH:
            raise UserError(
                f"pose {name}: the flange is {np.linalg.norm(X[:3, 3]):.0f} m from the base: give metres, not "
                "millimetres"
            )


def check_fit(
    refined: Refined,
    Xs_base_flange: Sequence[Array],
    Xs_camera_board: Sequence[Array],
    own: Array,
    board: Board,
    intrinsics: CameraIntrinsics,
) -> None:
    """Refuse a calibration whose residuals no arm and no camera have, with the probable cause.

    Args:
        refined: The calibration.
        Xs_base_flange: Poses of the flange, (4, 4) each.
        Xs_camera_board: Poses of the board as the images show it, (4, 4) each.
        own: Root mean square reprojection error of each image under its own pose of the board, (N,) [px].
        board: The board.
        intrinsics: Pinhole model of the images.

    Raises:
        UserError: The corners do not fit the board (`user.calibration_image`), or the images not the arm's poses
            (`user.calibration_misfit`).
    """
    noise = refined.noise
    if (pixel := float(np.median(own))) > PIXEL:
        raise UserError(
            f"in a single image the corners are {pixel:.1f} px off a board of {board.columns} x {board.rows} "
            f"squares with a focal length of {intrinsics.fx:.0f} px. Possible causes: other intrinsics, an "
            "uncorrected lens distortion, a bent board, or a board that moved",
            code="user.calibration_image",
        )
    good = float(np.mean(refined.weights > 0.5))
    if noise.position <= ARM_POSITION and noise.rotation <= ARM_ROTATION and good >= 0.5:
        return
    position, rotation = np.median(refined.arm_errors, axis=0)
    cause = _other_reading(Xs_base_flange, Xs_camera_board)
    raise UserError(
        f"images and arm do not fit: the arm would be {position * 1e3:.0f} mm and {np.rad2deg(rotation):.1f}° off in "
        f"half of the poses. {cause}",
        code="user.calibration_misfit",
    )


def check_scale(scale: tuple[float, float], board: Board) -> None:
    """Refuse a board whose square is not what was given: the arm's own motions tell it.

    Args:
        scale: Factor on the square that fits best, and its standard deviation.
        board: The board as given.

    Raises:
        UserError: The square deviates.
    """
    factor, sigma = scale
    if abs(factor - 1.0) > max(SCALE, SIGMAS * sigma):
        raise UserError(
            f"the squares are not {board.square * 1e3:.2f} mm: the arm's motions give "
            f"{factor * board.square * 1e3:.2f} ± {2 * sigma * board.square * 1e3:.2f} mm. Measure the scale bars "
            "of the print again. If they are right, the focal length or the unit of the arm's positions is wrong"
        )


def check_place(X_base_camera: Array, expected: Array) -> None:
    """Refuse a camera that is not where a person has measured it, and notice the half turn of the base.

    Args:
        X_base_camera: Calibrated pose of the camera, (4, 4).
        expected: Its place in `base` as measured by hand, (3,) [m].

    Raises:
        UserError: It is elsewhere: half a turn about the base (`user.calibration_half_turn`), or somewhere else
            (`user.calibration_place`).
    """
    place = X_base_camera[:3, 3]
    if not camera_is_elsewhere(place, expected):
        return
    if half_a_turn_apart(place, expected):
        raise UserError(
            f"the calibrated camera, {_text(place)} m in base_link, and the station file's, {_text(expected)} m: "
            f"{HALF_A_TURN}",
            code="user.calibration_half_turn",
        )
    off = float(np.linalg.norm(place - expected))
    remedy = "measure the camera's position again, and check that poses and board are this robot's"
    if axes_swapped(place, expected):
        remedy += ". If x and y are swapped in the file, correct both the camera's position and its target"
    raise UserError(
        f"the camera comes out at {_text(place)} m in base_link, {off:.2f} m from the station file's {_text(expected)} "
        f"m: {remedy}",
        code="user.calibration_place",
    )


def check_depths(depths: Array, expected: Array) -> None:
    """Refuse a camera whose depth is in another unit, or belongs to another image.

    Args:
        depths: Depth image at corners of the board, (M,) [m]; NaN or 0 where unknown.
        expected: Depth of these corners by the colour image, (M,) [m].

    Raises:
        UserError: The depth has another unit, or does not fit.
    """
    known = np.isfinite(depths) & (depths > 0.0)
    if np.count_nonzero(known) < 20:
        return
    ratio = float(np.median(depths[known] / expected[known]))
    if 0.95 < ratio < 1.05:
        return
    if ratio > 100.0 or ratio < 0.02:
        raise UserError(
            f"the depth at the board is {ratio:.3g} times that of the colour image, so depth_unit is wrong. Give "
            "the length of one depth step in metres, such as 0.001 for millimetres"
        )
    raise UserError(
        f"the depth at the board is {ratio:.3f} times that of the colour image. Either depth is not registered to "
        "colour, or the intrinsics are another stream's, or the board's scale is wrong"
    )


def _other_reading(flange: Sequence[Array], board: Sequence[Array]) -> str:
    readings: dict[str, Callable[[Array], Array]] = {
        "They fit as X_flange_base: invert the arm's poses": inverse,
        "They fit with every rotation transposed: the rotation's convention is wrong": _transposed,
        "They fit with quaternions read as w, x, y, z: their order is wrong": _quaternion,
        "They fit with x and y swapped: give x and y in the robot's order": _swapped,
    }
    as_given = _misfit(flange, board)
    for text, read in readings.items():
        if _misfit([read(X) for X in flange], board) < _BETTER * as_given:
            return text
    for shift in (1, -1):
        moved = list(flange[shift:]) + list(flange[:shift])
        if _misfit(moved, board) < _BETTER * as_given:
            return "They fit if shifted by one: each image is paired with the pose of another image"
    return (
        "Does the board move on the flange? Did the arm stand still when the images were taken? Are images and poses "
        "in the same order, and is it this robot's kinematics?"
    )


def _misfit(flange: Sequence[Array], board: Sequence[Array]) -> float:
    """Median distance of the board in the flange from its mean, in closed form [m]."""
    found = closed_form(flange, board)
    if found is None:
        return np.inf
    expected = inverse(np.asarray(flange)) @ found.X_base_camera @ np.asarray(board)
    return float(np.median(np.linalg.norm(expected[:, :3, 3] - np.median(expected[:, :3, 3], axis=0), axis=1)))


def _transposed(X: Array) -> Array:
    Y = X.copy()
    Y[:3, :3] = X[:3, :3].T
    return Y


def _quaternion(X: Array) -> Array:
    """The pose if its quaternion w, x, y, z was read as x, y, z, w."""
    w, x, y, z = Rotation.from_matrix(X[:3, :3]).as_quat()
    return transform(Rotation.from_quat([x, y, z, w]), X[:3, 3])


def _swapped(X: Array) -> Array:
    """The pose with the base's and the flange's x and y swapped, which mirrors both."""
    P = np.eye(4)[[1, 0, 2, 3]]
    return np.asarray(P @ X @ P)


def _text(p: Array) -> str:
    return "(" + ", ".join(f"{v:.2f}" for v in p) + ")"
