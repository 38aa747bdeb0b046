"""The station file's `calibration.record`: read, and checked against the rest of the file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from toolee_robot.calibration.intrinsics_record import same_distortion
from toolee_robot.calibration.record import (
    CalibrationRecord,
    axes_swapped,
    camera_is_elsewhere,
    half_a_turn_apart,
    read_record,
)
from toolee_robot.errors import ConfigError
from toolee_robot.frames import HALF_TURN, BaseFrame
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
        ConfigError: The record cannot be read or was altered, or the file gives what the record gives, or a pose that
            is not given so (`config.camera_pose`).
    """
    camera = data.get("camera")
    if by_hand := [name for name in ("pose", "measured_pose") if isinstance(camera, dict) and name in camera]:
        raise ConfigError(
            f"{path}: camera.{by_hand[0]} is not given by hand: name a calibration's record in {SECTION}.{FIELD}, or "
            "give the pose by another program in camera.X_base_camera",
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
    record: CalibrationRecord,
    intrinsics: CameraIntrinsics,
    distortion: tuple[float, ...] | None,
    kinematics: DhCalibration | None,
    path: Path,
) -> None:
    """Refuse a record that is of another camera model or other kinematics than the station file's.

    Args:
        record: The record.
        intrinsics: Pinhole model of the station file's camera.
        distortion: Distortion that the file states; None for none.
        kinematics: The arm's factory calibration in the station file; None for nominal kinematics.
        path: The station file, for the errors.

    Raises:
        ConfigError: They differ: the pose of the camera does not hold with other intrinsics
            or another distortion (`config.calibration_intrinsics`) or kinematics (`config.calibration_kinematics`).
    """
    if not record.intrinsics.agrees(intrinsics):
        raise ConfigError(
            f"{path}: the calibration is of a camera with {_differing(record.intrinsics, intrinsics)}: the camera's "
            "pose holds with its own intrinsics only; enter those, or delete the section `calibration` (of "
            "measured.yaml, if a command wrote it) and calibrate again",
            code="config.calibration_intrinsics",
        )
    if not same_distortion(record.distortion, distortion):
        raise ConfigError(
            f"{path}: the calibration was made with camera.distortion {_of(record.distortion)}, the file's is "
            f"{_of(distortion)}: the camera's pose holds with images that are undistorted as then only; restore it, or "
            "delete the section `calibration` (of measured.yaml, if a command wrote it) and calibrate again",
            code="config.calibration_intrinsics",
        )
    computed = any(pose.q is not None for pose in record.poses)
    if computed and record.kinematics != kinematics:
        raise ConfigError(
            f"{path}: the calibration was made with another arm.calibration than the file's: restore the arm's, or "
            "delete the section `calibration` (of measured.yaml, if a command wrote it) and calibrate again",
            code="config.calibration_kinematics",
        )


def check_place(record: CalibrationRecord, expected: Sequence[float], field: str, frame: BaseFrame, path: Path) -> None:
    """Refuse a record whose camera stands far from where the station file has it.

    Args:
        record: The record.
        expected: The camera's place by the file, in `base`, (3,) [m].
        field: The field of the file that tells it.
        frame: The frame that the file names, in which the message tells places.
        path: The station file, for the errors.

    Raises:
        ConfigError: They differ by half a turn of the base (`config.calibration_half_turn`), or otherwise
            (`config.calibration_place`).
    """
    place, by_file = record.pose[:3, 3], np.asarray(expected, float)
    if not camera_is_elsewhere(place, by_file):
        return
    calibrated, typed = (_told(p, frame) for p in (place, by_file))
    if half_a_turn_apart(place, by_file):
        raise ConfigError(
            f"{path}: half a turn about the base's z lies between the calibrated camera, {calibrated} m in {frame}, "
            f"and {field}, {typed} m: the file's `frame` names the other base, or its positions are of the "
            "other",
            code="config.calibration_half_turn",
        )
    off = float(np.linalg.norm(place - by_file))
    remedy = "measure that again (x, y, z in this order)"
    if axes_swapped(place, by_file):
        remedy += ", or x and y are swapped there: then correct them"
    raise ConfigError(
        f"{path}: the calibrated camera stands at {calibrated} m in {frame}, {off:.2f} m from {field}, {typed} m: "
        f"{remedy}; if the camera was moved, delete the section `calibration` (of measured.yaml, if a command wrote "
        "it) and calibrate again",
        code="config.calibration_place",
    )


def _told(place: Any, frame: BaseFrame) -> list[float]:
    """A point of `base` in a frame, rounded for people."""
    turned = HALF_TURN[:3, :3] @ place if frame is BaseFrame.PENDANT_BASE else place
    return [0.0 + round(float(x), 2) for x in turned]


def _of(distortion: tuple[float, ...] | None) -> str:
    return "null" if distortion is None else f"{[round(v, 5) for v in distortion]}"


def _differing(record: CameraIntrinsics, file: CameraIntrinsics) -> str:
    """Which intrinsics of the record's camera the file has otherwise."""
    names = ("width", "height", "fx", "fy", "cx", "cy")
    pairs = [(name, getattr(record, name), getattr(file, name)) for name in names]
    return ", ".join(f"{name} {a:.6g} (the file's: {b:.6g})" for name, a, b in pairs if abs(a - b) > 0.01)
