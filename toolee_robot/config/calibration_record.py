"""The station file's `calibration.record`: read, and checked against the rest of the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from toolee_robot.calibration.record import CalibrationRecord, read_record
from toolee_robot.errors import ConfigError
from toolee_robot.types import CameraIntrinsics, DhCalibration

SECTION, FIELD = "calibration", "record"
"""Section and field that name the record."""
OF_RECORD = ("measured_on", "robot_serial", "camera_serial", "residual")
"""Fields of the section that the record gives."""


def take_record(data: dict[str, Any], path: Path) -> tuple[dict[str, Any], CalibrationRecord | None]:
    """Read the record that a station file names.

    Args:
        data: What the file holds.
        path: The file, in whose folder a relative path begins.

    Returns:
        The data with what the record gives, and the record; None where the file names none.

    Raises:
        ConfigError: The record cannot be read or was altered, or the file gives what the record gives.
    """
    if "pose" in (data.get("camera") or {}):
        raise ConfigError(
            f"{path}: camera.pose is not given by hand: name a calibration's record in {SECTION}.{FIELD}",
            code="config.camera_pose",
        )
    section = data.get(SECTION)
    if not isinstance(section, dict) or not isinstance(name := section.get(FIELD), str):
        return data, None
    if double := [field for field in OF_RECORD if field in section]:
        raise ConfigError(
            f"{path}: {SECTION}.{FIELD} gives {', '.join(double)}: leave them out of the station file",
            code="config.calibration_twice",
        )
    record = read_record(path.parent / name)
    given = {
        "measured_on": record.measured_at[:10],
        "robot_serial": record.robot_serial,
        "camera_serial": record.camera_serial,
        "residual": record.residual,
    }
    return {**data, SECTION: {**section, **given}}, record


def check_record(
    record: CalibrationRecord, intrinsics: CameraIntrinsics, kinematics: DhCalibration | None, path: Path
) -> None:
    """Refuse a record that is of another camera model or other kinematics than the station file's.

    Args:
        record: The record.
        intrinsics: Pinhole model of the station file's camera.
        kinematics: The arm's factory calibration in the station file; None for nominal kinematics.
        path: The station file, for the errors.

    Raises:
        ConfigError: They differ: the pose of the camera does not hold with other intrinsics
            (`config.calibration_intrinsics`) or kinematics (`config.calibration_kinematics`).
    """
    if not record.intrinsics.agrees(intrinsics):
        raise ConfigError(
            f"{path}: the calibration is of {record.intrinsics}, the file's camera is {intrinsics}: the camera's pose "
            "holds with its own intrinsics only; enter those, or calibrate again",
            code="config.calibration_intrinsics",
        )
    computed = any(pose.q is not None for pose in record.poses)
    if computed and record.kinematics != kinematics:
        raise ConfigError(
            f"{path}: the calibration was made with another arm.calibration than the file's: calibrate again, or "
            "restore the arm's",
            code="config.calibration_kinematics",
        )
