"""What a station file says of its camera as a whole: its pose by another program, and the record of its intrinsics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.record import read_intrinsics, rows, same_distortion
from toolee_robot.errors import ConfigError
from toolee_robot.frames import Array, BaseFrame, transform

CAMERA, INTRINSICS, HELD = "camera", "intrinsics", "intrinsics_record"
"""Section and field that name the record, and the field of `CameraConfig` that holds the name."""
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
            (`config.intrinsics_serial`); or the file gives by hand what only a record gives.
    """
    camera = data.get(CAMERA)
    if not isinstance(camera, dict):
        return data
    if HELD in camera:
        raise ConfigError(
            f"{path}: {CAMERA}.{HELD} cannot be given by hand. Name a record of `toolee calibrate intrinsics` "
            f"in {CAMERA}.{INTRINSICS}"
        )
    if INTRINSICS not in camera:
        return data
    others = {name: value for name, value in camera.items() if name != INTRINSICS}
    name = camera[INTRINSICS]
    if not isinstance(name, str):
        return {**data, CAMERA: {**others, HELD: name}}
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
            f"{path}: the record in {CAMERA}.{INTRINSICS} has {', '.join(differing)}. Leave these out of the file, "
            "because the record gives them; or leave the record out",
            code="config.intrinsics_twice",
        )
    device = others.get("device")
    serial = device.get("serial") if isinstance(device, dict) else None
    if isinstance(serial, str) and record.camera_serial != serial:
        raise ConfigError(
            f"{path}: the record in {CAMERA}.{INTRINSICS} belongs to camera {record.camera_serial!r}, the file "
            f"names {serial!r}. Measure this one by `toolee calibrate intrinsics --station {path} --write`",
            code="config.intrinsics_serial",
        )
    given = {**pinhole, "distortion": distortion, HELD: name}
    return {**data, CAMERA: {**others, **given}}


def given_by_intrinsics(record: Any) -> set[str]:
    """Tell which measured fields a record of the intrinsics makes unnecessary.

    Args:
        record: The station file's `camera.intrinsics`; None for none.

    Returns:
        Names of the fields, such as `camera.fx`.
    """
    return set() if record is None else {f"{CAMERA}.{name}" for name in (*PINHOLE, "distortion")}


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


POSE_FIELD, POSE_HELD = "X_base_camera", "measured_pose"
"""Field of the section that gives the pose, and that of `CameraConfig` that holds it."""
LOOK_AT = ("position", "target")
"""Fields that tell the pose otherwise."""
TOLERANCE = 1e-3
"""Largest error of a quaternion's norm, of an element of R R^T, and of the last row: digits that were rounded off."""
FARTHEST = 10.0
"""Largest distance of a camera from the base [m]."""
_FORMS = (
    "give four rows of four numbers, `[[r, r, r, x], [r, r, r, y], [r, r, r, z], [0, 0, 0, 1]]`, or "
    "`{position: [x, y, z], quaternion: [x, y, z, w]}`, in metres, with w last"
)


def take_camera_pose(data: dict[str, Any], frame: BaseFrame, path: Path) -> dict[str, Any]:
    """Convert the pose of the camera that a station file gives as a whole.

    Args:
        data: What the file holds.
        frame: The frame of its positions: the pose that it gives is that of the camera's optical frame (z forward, x
            right, y down) in this frame.
        path: The file, for the errors.

    Returns:
        The data with `camera.measured_pose`, X_base_camera as rows [m], instead of `camera.X_base_camera`; unchanged
        where the file gives none.

    Raises:
        ConfigError: The file gives `position` or `target` as well, or what it gives is neither form, has a quaternion
            whose norm is not 1, is no rotation but a mirror image, has another last row than 0 0 0 1, or is in
            millimetres.
    """
    camera = data.get(CAMERA)
    if not isinstance(camera, dict) or camera.get(POSE_FIELD) is None:
        return data
    if given := [f"{CAMERA}.{name}" for name in LOOK_AT if camera.get(name) is not None]:
        raise ConfigError(
            f"{path}: {CAMERA}.{POSE_FIELD} is the whole pose, and {' and '.join(given)} give it again: leave out "
            "one or the other"
        )
    named = f"{path}: {CAMERA}.{POSE_FIELD}"
    value = camera[POSE_FIELD]
    X = _of_quaternion(value, named) if isinstance(value, dict) else _of_matrix(value, named)
    distance = float(np.linalg.norm(X[:3, 3]))
    if distance > FARTHEST:
        raise ConfigError(
            f"{named}: the camera is {distance:.0f} m from the base, which looks like millimetres: give metres"
        )
    others = {name: field for name, field in camera.items() if name not in (POSE_FIELD, *LOOK_AT)}
    return {**data, CAMERA: {**others, POSE_HELD: rows(frame.X_base_this @ X), **dict.fromkeys(LOOK_AT)}}


def _of_quaternion(value: dict[Any, Any], named: str) -> Array:
    if set(value) != {"position", "quaternion"}:
        raise _no_form(named, f"has the fields {', '.join(map(str, value)) or 'none'}")
    p, q = _numbers(value["position"], 3), _numbers(value["quaternion"], 4)
    if p is None or q is None:
        name, numbers = ("position", 3) if p is None else ("quaternion", 4)
        raise _no_form(named, f"has the {name} {value[name]!r}, which is not {numbers} numbers")
    norm = float(np.linalg.norm(q))
    if abs(norm - 1.0) > TOLERANCE:
        raise ConfigError(
            f"{named}: the quaternion {q.tolist()} has the norm {norm:.4f}, not 1. Give x, y, z, w in this order, "
            "with all digits of the calibration program"
        )
    return transform(Rotation.from_quat(q), p)


def _of_matrix(value: Any, named: str) -> Array:
    lines = [_numbers(row, 4) for row in value] if isinstance(value, list | tuple) else []
    X = np.array([row for row in lines if row is not None])
    if len(lines) != 4 or len(X) != 4:
        raise _no_form(named, f"is {value!r}")
    if np.abs(X[3] - [0.0, 0.0, 0.0, 1.0]).max() > TOLERANCE:
        transposed = np.abs(X[:, 3] - [0.0, 0.0, 0.0, 1.0]).max() <= TOLERANCE
        remedy = "the matrix is transposed: give its columns as rows" if transposed else "give X_base_camera, 4 x 4"
        raise ConfigError(f"{named}: the last row is {X[3].tolist()} instead of [0, 0, 0, 1]: {remedy}")
    R = X[:3, :3]
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    if off > TOLERANCE:
        raise ConfigError(
            f"{named}: the upper left 3 x 3 is not a rotation: R R^T differs from the identity by {off:.4f}. Give "
            "the matrix with all its digits, and without a scale"
        )
    if np.linalg.det(R) < 0.0:
        raise ConfigError(
            f"{named}: the upper left 3 x 3 is a mirror image, its determinant is -1. One axis has the wrong sign, "
            "or two are swapped. The camera's axes are x right, y down, z forward"
        )
    U, _, Vt = np.linalg.svd(R)  # the nearest rotation: what is behind this wants more than the digits of a report
    return transform(U @ Vt, X[:3, 3])


def _no_form(named: str, what: str) -> ConfigError:
    return ConfigError(f"{named} {what}: {_FORMS}")


def _numbers(value: Any, count: int) -> Array | None:
    """A list of finite numbers, (count,); None for anything else."""
    if not isinstance(value, list | tuple) or len(value) != count or any(isinstance(part, bool) for part in value):
        return None
    try:
        numbers = np.array([float(part) for part in value])  # YAML takes 1e-05 for a text
    except (TypeError, ValueError):
        return None
    return numbers if np.all(np.isfinite(numbers)) else None
