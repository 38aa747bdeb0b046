"""The calibration of a fixed camera to the robot: from observations to a checked result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.hand_eye.diagnosis import check_fit, check_place, check_poses, check_scale
from toolee_robot.calibration.hand_eye.refinement import Refined, refine
from toolee_robot.calibration.hand_eye.reprojection import (
    METHOD,
    SCALE,
    Estimate,
    MotionSpread,
    Views,
    check_motion,
    closed_form,
)
from toolee_robot.calibration.observation import Observation, camera_board
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.types import CameraIntrinsics

TARGET_DISTANCE = 0.95
"""Distance of the point on the optical axis at which errors are told where no other is given [m]."""
WRONG = 30.0
"""Misfit of a view, see `Refined.misfits`, above which it is reported as wrong."""


@dataclass(frozen=True, eq=False)
class LeaveOneOut:
    """What changes when one pose at a time is left out.

    Attributes:
        held_out: Root mean square distance of each left-out view's corners from where the others expect them, across
            the line of sight, (N,) [m]. Along it a single view says little.
        shifts: Displacement of the target in each of these calibrations, (N,) [m].
    """

    held_out: Array
    shifts: Array

    @property
    def residual(self) -> float:
        """Root mean square over all views of `held_out` [m]."""
        return float(np.sqrt(np.mean(self.held_out**2)))


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A calibration of the camera, and how far it can be relied on.

    Attributes:
        names: Names of the poses, N.
        refined: The refined calibration.
        target: A point in the camera's frame at which errors are told, (3,) [m].
        spread: Rotations between the poses.
        methods: Displacement of the target by the closed form from the refined calibration [m], by method.
        leave_one_out: What changes without one pose.
        scale: Factor on the board's square that the poses themselves tell, and its standard deviation.
        reprojection: Root mean square reprojection error of each view, with the flange where the arm says, (N,) [px].
    """

    names: tuple[str, ...]
    refined: Refined
    target: Array
    spread: MotionSpread
    methods: Mapping[str, float]
    leave_one_out: LeaveOneOut
    scale: tuple[float, float]
    reprojection: Array

    @property
    def X_base_camera(self) -> Array:
        """Pose of the camera, (4, 4)."""
        return self.refined.estimate.X_base_camera

    @property
    def target_radius(self) -> float:
        """Largest half axis of the region in which the target's true place is with a probability of 95 % [m]."""
        covariance = self.refined.point_covariance(self.target)
        return float(np.sqrt(self.refined.confidence_factor() * np.linalg.eigvalsh(covariance)[-1]))

    @property
    def wrong(self) -> list[str]:
        """Names of the poses that do not fit the others and hardly count."""
        return [name for name, misfit in zip(self.names, self.refined.misfits, strict=True) if misfit > WRONG]


def calibrate(
    observations: Sequence[Observation],
    board: Board,
    intrinsics: CameraIntrinsics,
    *,
    expected: Array | None = None,
) -> CameraCalibration:
    """Calibrate a fixed camera to the robot from views of a board on the flange.

    A closed form gives the start, `refine` the result. What is implausible is refused with its probable cause.

    Args:
        observations: Poses of the flange, and the corners seen there.
        board: The board with its measured square.
        intrinsics: Pinhole model of the images.
        expected: Place of the camera in `base` as measured by hand, (3,) [m]; None if unknown, and a half turn of the
            base is then not noticed.

    Returns:
        The calibration.

    Raises:
        UserError: The poses are too few or do not determine it, or the result is implausible: see `diagnosis`.
    """
    check_poses([o.X_base_flange for o in observations], [o.name for o in observations])
    spread = check_motion([o.X_base_flange for o in observations])
    target = np.array([0.0, 0.0, TARGET_DISTANCE])
    views = Views(observations, board, intrinsics)
    Xs_camera_board = [camera_board(o.view, board, intrinsics)[0] for o in observations]
    begin = start(observations, Xs_camera_board)
    refined = refine(views, begin)
    own = [o.view.reprojection(X, board, intrinsics) for o, X in zip(observations, Xs_camera_board, strict=True)]
    flange = [o.X_base_flange for o in observations]
    check_fit(refined, flange, Xs_camera_board, np.array(own), board, intrinsics)
    scaled = refine(views, refined.estimate, noise=refined.noise, square_error=np.inf)
    scale = scaled.estimate.scale, float(np.sqrt(scaled.covariance[SCALE, SCALE]))
    check_scale(scale, board)
    if expected is not None:
        check_place(refined.estimate.X_base_camera, expected)
    at = _point(refined.estimate, target)
    residuals = views.project(refined.estimate).residuals
    return CameraCalibration(
        names=tuple(o.name for o in observations),
        refined=refined,
        target=target,
        spread=spread,
        methods={METHOD: float(np.linalg.norm(_point(begin, target) - at))},
        leave_one_out=_leave_one_out(observations, board, intrinsics, refined, target),
        scale=scale,
        reprojection=np.sqrt(np.sum(residuals**2, axis=1) / views.count),
    )


def start(observations: Sequence[Observation], Xs_camera_board: Sequence[Array]) -> Estimate:
    """Calibrate in closed form, for the refinement to start from.

    Args:
        observations: Poses of the flange.
        Xs_camera_board: Poses of the board as the images show it, (4, 4) each.

    Returns:
        The estimate.

    Raises:
        UserError: There is none.
    """
    found = closed_form([o.X_base_flange for o in observations], Xs_camera_board)
    if found is None:
        raise UserError("OpenCV finds no calibration for these poses: are they of this robot and this board?")
    return found


def _leave_one_out(
    observations: Sequence[Observation], board: Board, intrinsics: CameraIntrinsics, refined: Refined, target: Array
) -> LeaveOneOut:
    at, held_out, shifts = _point(refined.estimate, target), [], []
    for i, left_out in enumerate(observations):
        others = Views([*observations[:i], *observations[i + 1 :]], board, intrinsics)
        estimate = refine(others, refined.estimate, noise=refined.noise).estimate
        X_camera_board = inverse(estimate.X_base_camera) @ left_out.X_base_flange @ estimate.X_flange_board
        corners = transform_points(X_camera_board, estimate.scale * board.corners[left_out.view.ids])
        across = corners - corners[:, 2:] * intrinsics.rays(left_out.view.pixels)
        held_out.append(np.sqrt(np.mean(np.sum(across**2, axis=1))))
        shifts.append(np.linalg.norm(_point(estimate, target) - at))
    return LeaveOneOut(np.array(held_out), np.array(shifts))


def _point(estimate: Estimate, p_camera: Array) -> Array:
    return np.asarray((estimate.X_base_camera @ [*p_camera, 1.0])[:3])
