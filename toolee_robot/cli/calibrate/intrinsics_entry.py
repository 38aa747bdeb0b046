"""The camera of a station file whose intrinsics are measured, and the entry of their record in the file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from toolee_robot.calibration.intrinsics_record import read_intrinsics
from toolee_robot.errors import ConfigError, UserError
from toolee_robot.runtime.yaml_files import to_record
from toolee_robot.station import SIMULATED, CameraConfig, read_station, write_measured
from toolee_robot.station.intrinsics_record import FIELD, PINHOLE, SECTION
from toolee_robot.stations.camera import WITH_MODE

NOMINAL_FOCAL = 0.72
"""Focal length of a rehearsed camera of which the file says none yet, in widths of the image."""
NUMBERS = ("fx", "fy", "cx", "cy", "distortion")
"""Fields of the section that a measurement changes; the size stays."""


def camera_of(path: Path) -> CameraConfig:
    """Read which camera a station file names, whatever the file says of its intrinsics.

    A record that was lost or altered is passed over: this measurement replaces it.

    Args:
        path: The station file.

    Returns:
        The camera: its device and size, its pinhole as far as the file tells it, and no distortion.

    Raises:
        ConfigError: The file cannot be read, names no device (`config.camera_device`), or leaves out the size that the
            driver asks the device for (`config.unmeasured`).
    """
    camera = _camera(path)
    kept = {name: camera[name] for name in ("device", *PINHOLE) if camera.get(name) is not None}
    lost = ""
    if isinstance(name := camera.get(FIELD), str):
        try:
            known = read_intrinsics(path.parent / name).intrinsics
            kept = {**{field: getattr(known, field) for field in PINHOLE}, **kept}
        except ConfigError as error:
            lost = f"; the record in camera.{FIELD} does not give them any more ({error})"
    if not isinstance(device := kept.get("device"), dict):
        raise ConfigError(
            f"{path}: camera.device is missing: give camera.device.driver, .serial and .least_range; `toolee camera "
            "list` shows the cameras of this computer",
            code="config.camera_device",
        )
    if "width" not in kept or "height" not in kept:
        if device.get("driver") in WITH_MODE:
            raise ConfigError(
                f"{path}: give camera.width and camera.height, a size that the camera has: intrinsics hold for one "
                f"size{lost}",
                code="config.unmeasured",
            )
    elif not kept.keys() >= {*PINHOLE}:
        width, height = float(kept["width"]), float(kept["height"])
        focal = NOMINAL_FOCAL * width
        kept = {"fx": focal, "fy": focal, "cx": (width - 1) / 2, "cy": (height - 1) / 2, **kept}
    return to_record(kept, path, CameraConfig, "station's camera")


def check_entry(path: Path, *, rehearsed: bool) -> None:
    """Refuse, before anything is measured, what could not be entered, or must not.

    Args:
        path: The station file.
        rehearsed: Whether the camera is emulated.

    Raises:
        UserError: The file names a calibration of the camera's place, which holds with the intrinsics of then only
            (`user.calibration_is_older`), or numbers or a record of a real camera, which rehearsed ones would replace
            (`user.calibration_is_real`); a record that cannot be read may be one.
    """
    if read_station(path).get("calibration"):
        raise UserError(
            f"{path} names a calibration of the camera's place, which holds with the intrinsics of then only: take its "
            "section `calibration` out (of measured.yaml, if a command wrote it), measure the intrinsics, then "
            "calibrate the place again",
            code="user.calibration_is_older",
        )
    camera = _camera(path)
    name = camera.get(FIELD)
    if rehearsed and (typed := [number for number in NUMBERS if camera.get(number) is not None]):
        raise UserError(
            f"{path} gives {', '.join(f'camera.{number}' for number in typed)}: a rehearsal's would take their place. "
            "Rehearse without --write, or with a copy of the file from which you take them out",
            code="user.calibration_is_real",
        )
    if rehearsed and isinstance(name, str) and not _rehearsed(path.parent / name):
        raise UserError(
            f"{path} names the intrinsics of a real camera, or a record that cannot be read, whose place a rehearsed "
            "record would take. Rehearse without --write, or with a copy of the file without camera.intrinsics",
            code="user.calibration_is_real",
        )


def enter(path: Path, record_file: Path) -> None:
    """Enter a record in `measured.yaml` beside a station file; it holds instead of the numbers that the file gives.

    Args:
        path: The station file.
        record_file: The record's file.

    Raises:
        ConfigError: The station would be refused with it; nothing was written.
    """
    write_measured(path, camera={FIELD: os.path.relpath(record_file, path.parent)})


def _rehearsed(record_file: Path) -> bool:
    try:
        return read_intrinsics(record_file).camera_serial == SIMULATED
    except ConfigError:
        return False


def _camera(path: Path) -> dict[str, Any]:
    data = read_station(path)
    camera = data.get(SECTION) if isinstance(data, dict) else None
    return camera if isinstance(camera, dict) else {}
