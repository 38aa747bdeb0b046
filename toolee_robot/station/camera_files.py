"""The pose of the camera by another program, as a station file gives it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.record import rows
from toolee_robot.errors import ConfigError
from toolee_robot.frames import Array, BaseFrame, transform

CAMERA = "camera"
"""The section."""
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
