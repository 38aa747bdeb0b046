"""The station file's `camera.intrinsics`: the record of the camera's intrinsics, read and checked against the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from toolee_robot.calibration.intrinsics_record import read_intrinsics, same_distortion
from toolee_robot.errors import ConfigError
from toolee_robot.station.calibration import SIMULATED

SECTION, FIELD, HELD = "camera", "intrinsics", "intrinsics_record"
"""Section and field that name the record, and the field of `CameraConfig` that holds the name."""
SERIAL = "lens_serial"
"""Field of `CameraConfig` that holds the serial number of the record."""
PINHOLE = ("fx", "fy", "cx", "cy", "width", "height")
"""Fields of the section that the record gives, beside `distortion`."""
ROUNDED = 0.01
"""Largest difference of a number that the file gives, too: digits that were rounded off [px]."""


def take_intrinsics(data: dict[str, Any], path: Path) -> dict[str, Any]:
    """Read the record of the camera's intrinsics that a station file names.

    Args:
        data: What the file holds.
        path: The file, in whose folder a relative path begins.

    Returns:
        The data with what the record gives; unchanged where the file names none.

    Raises:
        ConfigError: The record cannot be read or was altered; or the file gives other numbers than the record
            (`config.intrinsics_twice`); or the record is of another camera than `camera.device.serial`
            (`config.intrinsics_serial`); or the file gives by hand what only a record gives (`config.invalid`).
    """
    camera = data.get(SECTION)
    if not isinstance(camera, dict):
        return data
    if by_hand := [name for name in (HELD, SERIAL) if name in camera]:
        raise ConfigError(
            f"{path}: {SECTION}.{by_hand[0]} is not given by hand: name a record of `toolee calibrate intrinsics` in "
            f"{SECTION}.{FIELD}",
            code="config.invalid",
        )
    if FIELD not in camera:
        return data
    others = {name: value for name, value in camera.items() if name != FIELD}
    name = camera[FIELD]
    if not isinstance(name, str):
        return {**data, SECTION: {**others, HELD: name}}
    record = read_intrinsics(path.parent / name)
    pinhole = {field: getattr(record.intrinsics, field) for field in PINHOLE}
    differing = [
        f"{field} {pinhole[field]:.6g} (the file's: {others[field]!r})"
        for field in PINHOLE
        if others.get(field) is not None and not _same(others[field], pinhole[field])
    ]
    distortion = list(record.distortion)
    if others.get("distortion") is not None and not _same_distortion(others["distortion"], distortion):
        differing.append(f"distortion {[round(v, 5) for v in distortion]} (the file's: {others['distortion']})")
    if differing:
        raise ConfigError(
            f"{path}: the record in {SECTION}.{FIELD} has {', '.join(differing)}: leave these out of the file, the "
            "record gives them; or leave the record out",
            code="config.intrinsics_twice",
        )
    device = others.get("device")
    serial = device.get("serial") if isinstance(device, dict) else None
    if isinstance(serial, str) and record.camera_serial not in (serial, SIMULATED):
        raise ConfigError(
            f"{path}: the record in {SECTION}.{FIELD} is of the camera {record.camera_serial!r}, the file's is "
            f"{serial!r}: measure this one by `toolee calibrate intrinsics --station {path} --write`",
            code="config.intrinsics_serial",
        )
    given = {**pinhole, "distortion": distortion, HELD: name, SERIAL: record.camera_serial}
    return {**data, SECTION: {**others, **given}}


def given_by_intrinsics(record: Any) -> set[str]:
    """Tell which measured fields a record of the intrinsics makes unnecessary.

    Args:
        record: The station file's `camera.intrinsics`; None for none.

    Returns:
        Names of the fields, such as `camera.fx`.
    """
    return set() if record is None else {f"{SECTION}.{name}" for name in (*PINHOLE, "distortion")}


def _same(given: Any, value: float) -> bool:
    try:
        return abs(float(given) - value) <= ROUNDED
    except (TypeError, ValueError):
        return False


def _same_distortion(given: Any, value: list[float]) -> bool:
    try:
        return same_distortion([float(v) for v in given], value)
    except (TypeError, ValueError):
        return False
