"""The record of a calibration, from its solution."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.hand_eye.solve import CameraCalibration
from toolee_robot.calibration.record import FORMAT, CalibrationRecord, RecordedPose, rows
from toolee_robot.calibration.session import Seen, Session
from toolee_robot.types import DhCalibration


def build_record(
    calibration: CameraCalibration,
    session: Session,
    seen: Seen,
    board: Board,
    *,
    bars: tuple[float, float] | None,
    robot_model: str,
    kinematics: DhCalibration | None,
    distortion: tuple[float, ...] | None,
    software: str,
    now: datetime,
) -> CalibrationRecord:
    """Build a record.

    Args:
        calibration: The solution.
        session: What was recorded.
        seen: What was found in its images.
        board: The board with its measured square.
        bars: Measured lengths of its scale bars [m], if it was measured so.
        robot_model: Model of the arm.
        kinematics: The arm's factory calibration; None for nominal kinematics.
        distortion: Distortion that the station file states; None for none.
        software: Version of this software.
        now: Date and time.

    Returns:
        The record.
    """
    refined, left_out = calibration.refined, calibration.leave_one_out
    poses = tuple(
        RecordedPose(
            name=o.name,
            q=q,
            X_base_flange=rows(o.X_base_flange),
            ids=tuple(int(i) for i in o.view.ids),
            pixels=rows(np.round(o.view.pixels, 4)),
            reprojection=float(reprojection),
            held_out=float(held_out),
            weight=float(weight),
        )
        for o, q, reprojection, held_out, weight in zip(
            seen.observations, seen.joints, calibration.reprojection, left_out.held_out, refined.weights, strict=True
        )
    )
    x, y, z = calibration.target.tolist()
    return CalibrationRecord(
        format=FORMAT,
        measured_at=now.isoformat(timespec="seconds"),
        software=software,
        robot_model=robot_model,
        robot_serial=session.robot_serial,
        kinematics=kinematics,
        camera_serial=session.camera_serial,
        intrinsics=session.intrinsics,
        board=board,
        bars=bars,
        X_base_camera=rows(refined.estimate.X_base_camera),
        X_flange_board=rows(refined.estimate.X_flange_board),
        covariance=rows(refined.covariance[:6, :6]),
        freedom=refined.freedom,
        pixel_noise=refined.noise.pixel,
        arm_noise=(refined.noise.position, refined.noise.rotation),
        residual=left_out.residual,
        largest_shift=float(left_out.shifts.max()),
        target=(x, y, z),
        target_radius=calibration.target_radius,
        methods=dict(calibration.methods),
        rotations=(calibration.spread.first, calibration.spread.second),
        board_scale=calibration.scale,
        poses=poses,
        distortion=distortion,
    )
