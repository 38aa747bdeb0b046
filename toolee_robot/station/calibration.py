"""The camera's calibration in a station file: its validity, and the record that `toolee calibrate camera` wrote."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from toolee_robot.calibration.record import (
    HALF_A_TURN,
    CalibrationRecord,
    axes_swapped,
    camera_is_elsewhere,
    half_a_turn_apart,
    read_record,
    same_distortion,
)
from toolee_robot.errors import ConfigError
from toolee_robot.frames import HALF_TURN, BaseFrame
from toolee_robot.station.schema import STRICT
from toolee_robot.types import CameraIntrinsics, DhCalibration
from toolee_robot.types.units import Metres, Unit

SIMULATED, REHEARSED = "simulated", "0"
"""Serial number of every simulated device, and of the robot of a rehearsed calibration (ur_rtde takes only digits of an
e-Series): no real one has them, so that no job on a robot takes what was rehearsed for its own."""


@dataclass(frozen=True)
class CalibrationConfig:
    """The hand-eye calibration that determined `StationConfig.camera`.

    It holds for one robot, one camera and a limited time. A station file names the `record` that `toolee calibrate
    camera` wrote, which gives date, serial numbers and residual; of a calibration by another program it gives these
    four itself.
    """

    __pydantic_config__ = STRICT
    measured_on: str
    """Date of the calibration, ISO 8601 (2026-11-20)."""
    robot_serial: str
    """Serial number of the calibrated robot, the same as the station's."""
    camera_serial: str
    """Serial number of the calibrated camera, the same as the station's."""
    residual: Annotated[float, Metres(0.0, 0.1)]
    """Root mean square error of the board's points across the line of sight, on poses that the fit did not use."""
    max_residual: Annotated[float, Metres(0.0001, 0.02)] = 0.004
    """Largest residual with which the calibration may be used."""
    valid_days: Annotated[float, Unit("days", 0.1, 3650.0)] | None = 30.0
    """Days until the calibration must be repeated; null: no limit, as in the simulation."""
    record: str | None = None
    """File with the calibration's record, relative to the station file."""

    def __post_init__(self) -> None:
        try:
            date.fromisoformat(self.measured_on)
        except ValueError as error:
            raise ValueError(f"measured_on {self.measured_on!r} is not a date: write it as 2026-11-20") from error

    def problems(self, robot_serial: str, camera_serial: str, today: date) -> list[str]:
        """Check whether this calibration may be used.

        Args:
            robot_serial: Serial number that the station's robot reports.
            camera_serial: Serial number that the station's camera reports.
            today: The present date.

        Returns:
            One sentence per reason against its use; empty if it may be used.
        """
        found = []
        for what, mine, theirs in (
            ("robot", self.robot_serial, robot_serial),
            ("camera", self.camera_serial, camera_serial),
        ):
            if mine != theirs:
                of = "it was simulated or rehearsed" if mine in (SIMULATED, REHEARSED) else f"it is of {what} {mine!r}"
                found.append(f"{of}, but the station has {what} {theirs!r}: calibrate this one")
        age = (today - date.fromisoformat(self.measured_on)).days
        if age < -1:  # dates have no zone: elsewhere it may be a day later
            found.append(f"it was measured on {self.measured_on}, in the future: set the computer's clock")
        elif self.valid_days is not None and age > self.valid_days:
            found.append(f"it is {age} days old, and {self.valid_days:g} are allowed: calibrate again")
        if self.residual > self.max_residual:
            found.append(
                f"its residual is {self.residual * 1e3:.1f} mm, and {self.max_residual * 1e3:.1f} are allowed: "
                "calibrate again with more and steeper poses"
            )
        return found


SIMULATED_CALIBRATION = CalibrationConfig("2026-01-01", SIMULATED, SIMULATED, 0.0, valid_days=None)
"""Calibration of the simulated station: exact, and valid without a time limit."""


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
            is not given so.
    """
    camera = data.get("camera")
    if by_hand := [name for name in ("pose", "measured_pose") if isinstance(camera, dict) and name in camera]:
        raise ConfigError(
            f"{path}: camera.{by_hand[0]} cannot be given by hand. Name a calibration's record in "
            f"{SECTION}.{FIELD}, or give another program's pose in camera.X_base_camera"
        )
    section = data.get(SECTION)
    if not isinstance(section, dict) or not isinstance(name := section.get(FIELD), str):
        return data, None
    if double := [field for field in OF_RECORD if field in section]:
        raise ConfigError(
            f"{path}: {SECTION}.{FIELD} already gives {', '.join(double)}: leave them out of the station file"
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
            or another distortion (`config.calibration_intrinsics`) or kinematics.
    """
    if not record.intrinsics.agrees(intrinsics):
        raise ConfigError(
            f"{path}: the calibration belongs to a camera with {_differing(record.intrinsics, intrinsics)}. Enter "
            "that camera's intrinsics, or delete the section `calibration` (of measured.yaml, if a command wrote "
            "it) and calibrate again",
            code="config.calibration_intrinsics",
        )
    if not same_distortion(record.distortion, distortion):
        raise ConfigError(
            f"{path}: the calibration was made with camera.distortion {_of(record.distortion)}, the file's is "
            f"{_of(distortion)}. Restore it, or delete the section `calibration` (of measured.yaml, if a command "
            "wrote it) and calibrate again",
            code="config.calibration_intrinsics",
        )
    computed = any(pose.q is not None for pose in record.poses)
    if computed and record.kinematics != kinematics:
        raise ConfigError(
            f"{path}: the calibration was made with another arm.calibration. Restore that, or delete the section "
            "`calibration` (of measured.yaml, if a command wrote it) and calibrate again"
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
        ConfigError: They differ by half a turn of the base, or otherwise.
    """
    place, by_file = record.pose[:3, 3], np.asarray(expected, float)
    if not camera_is_elsewhere(place, by_file):
        return
    calibrated, typed = (_told(p, frame) for p in (place, by_file))
    if half_a_turn_apart(place, by_file):
        raise ConfigError(
            f"{path}: the calibrated camera, {calibrated} m in {frame}, and {field}, {typed} m: {HALF_A_TURN}"
        )
    off = float(np.linalg.norm(place - by_file))
    remedy = "measure that again (x, y, z in this order)"
    if axes_swapped(place, by_file):
        remedy += ", or swap x and y, which are exchanged there"
    raise ConfigError(
        f"{path}: the calibrated camera stands at {calibrated} m in {frame}, {off:.2f} m from {field}, {typed} m: "
        f"{remedy}. If the camera was moved, delete the section `calibration` (of measured.yaml, if a command wrote "
        "it) and calibrate again"
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
