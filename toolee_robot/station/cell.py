"""Objects of the station: camera, work, tool and obstacles."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.record import Rows, rows
from toolee_robot.errors import ConfigError
from toolee_robot.frames import Array, BaseFrame, frame_from_axes, transform
from toolee_robot.runtime.yaml_files import IN_FILE
from toolee_robot.station.schema import STRICT, Extent, JointAngle, JointAngles, Place, Point
from toolee_robot.types import CameraIntrinsics
from toolee_robot.types.units import Direction, Metres, Number, Pixels, Seconds, Unit

BODY_NAMES = ("table", "stand", "block", "camera", "person")
"""Names of the bodies that every station has."""
COEFFICIENTS = (4, 5)
"""How many numbers a lens's distortion has: k1, k2, p1, p2 and, where it has one, k3."""
LARGEST_TANGENTIAL = 0.05
"""Largest tangential coefficient of a lens: those of real ones are under 0.01."""
VERTICAL = 1e-6
"""Sine of the angle from the vertical up to which position and target tell no level rows of the image."""


@dataclass(frozen=True)
class Obstacle:
    """A box that arm, hand and tool keep clear of, such as a fence, a shelf or a fixture."""

    __pydantic_config__ = STRICT
    name: Annotated[str, Field(pattern=r"^\w[\w -]{0,39}$")]
    """Name, for messages and pictures."""
    center: Point
    """Centre in `base`."""
    size: tuple[Extent, Extent, Extent]
    """Edge lengths along the box's own axes."""
    rotation: tuple[JointAngle, JointAngle, JointAngle] = (0.0, 0.0, 0.0)
    """Rotation vector of the box in `base`, as the teach pendant shows rotations; zero: parallel to `base`."""

    @property
    def X_base_box(self) -> Array:
        """Pose of the box's centre and axes in `base`, (4, 4)."""
        if not np.any(self.rotation):
            return transform(p=self.center)
        return transform(Rotation.from_rotvec(self.rotation), self.center)


@dataclass(frozen=True)
class CameraDevice:
    """The camera as its driver opens it. Size and intrinsics are those of `camera`."""

    __pydantic_config__ = STRICT
    driver: str
    """Name of the driver, from `toolee devices list`."""
    serial: str
    """Serial number of the camera. A calibration holds for this camera only."""
    least_range: Annotated[float, Metres(0.01, 5.0)]
    """Least depth that the camera measures in this mode, from its data sheet. Views of a job are farther away.
    """
    fps: Annotated[int, Unit("1/s", 1, 300)] = 30
    """Frames per second of colour and depth."""
    exposure: Annotated[float, Seconds(0.00002, 1.0)] | None = None
    """Exposure of the colour image; null: automatic, which varies between views."""
    folder: str | None = None
    """Folder of the recording, for the driver `recorded`."""


@dataclass(frozen=True)
class CameraConfig:
    """Pose and intrinsics of the fixed camera (eye-to-hand).

    The pose is that of the optical frame (z forward, x right, y down): `X_base_camera`, or `position` and `target`, by
    which the rows of the image are level. A simulated camera stands exactly where these say, whatever a record says.
    """

    __pydantic_config__ = STRICT
    fx: Annotated[float, Pixels(10.0, 20_000.0)]
    """Focal length along x."""
    fy: Annotated[float, Pixels(10.0, 20_000.0)]
    """Focal length along y."""
    cx: Annotated[float, Pixels(1.0, 10_000.0)]
    """Principal point, x."""
    cy: Annotated[float, Pixels(1.0, 10_000.0)]
    """Principal point, y."""
    width: Annotated[int, Pixels(16, 10_000)]
    """Width of the image."""
    height: Annotated[int, Pixels(16, 10_000)]
    """Height of the image."""
    position: Point | None = None
    """Optical centre in `base`; left out with `X_base_camera`."""
    target: Point | None = None
    """A point on the optical axis, in `base`, not directly above or below `position`; left out with
    `X_base_camera`.
    """
    measured_pose: Rows | None = field(default=None, metadata={IN_FILE: "X_base_camera"})
    """Pose of the optical frame in `base` by another calibration program, instead of `position` and `target`: four
    rows of four numbers, or `{position: [x, y, z], quaternion: [x, y, z, w]}`."""
    distortion: tuple[Annotated[float, Number(-100.0, 100.0)], ...] | None = None
    """Distortion of the lens by OpenCV's model: k1, k2, p1, p2 and optionally k3. All 0: the driver's images are
    undistorted; null: the camera reports its own, or it is unknown.
    """
    device: CameraDevice | None = None
    """The camera itself, for its driver; null for the simulated one."""
    pose: Rows | None = field(default=None, metadata={IN_FILE: ""})
    """X_base_camera of the calibration's record, 4 x 4, which replaces the measured pose; null without a record."""

    def __post_init__(self) -> None:
        if self.measured_pose is None and self.pose is None:
            self._check_target()
        if self.distortion is not None:
            _check_distortion(self.distortion)

    def _check_target(self) -> None:
        if self.position is None or self.target is None:
            raise ValueError("position and target are missing: give both, or X_base_camera instead of both")
        z = np.subtract(self.target, self.position)
        if np.hypot(z[0], z[1]) <= VERTICAL * np.linalg.norm(z):
            raise ValueError(
                "target lies directly above or below position, so the rotation about the optical axis is "
                "undefined: give X_base_camera instead of both"
            )

    @property
    def intrinsics(self) -> CameraIntrinsics:
        """The pinhole model of the undistorted image."""
        return CameraIntrinsics(self.fx, self.fy, self.cx, self.cy, self.width, self.height)

    @property
    def X_base_camera(self) -> Array:
        """Pose of the camera in `base`, (4, 4), OpenCV axes."""
        whole = self.measured_pose if self.pose is None else self.pose
        if whole is not None:
            return np.array(whole)
        assert self.position is not None, "checked at the construction"
        assert self.target is not None, "checked at the construction"
        z = np.subtract(self.target, self.position)
        x = np.cross(z, [0.0, 0.0, 1.0])
        return frame_from_axes(z=z, x=x, p=self.position)

    @property
    def center(self) -> tuple[float, float, float]:
        """Optical centre in `base` [m], by the record if there is one."""
        x, y, z = self.X_base_camera[:3, 3].tolist()
        return x, y, z

    @property
    def uncalibrated(self) -> CameraConfig:
        """The camera without its calibration: where a person has measured it, and where a simulated one stands."""
        return replace(self, pose=None)


def _check_distortion(distortion: tuple[float, ...]) -> None:
    if len(distortion) not in COEFFICIENTS:
        raise ValueError(f"distortion has {len(distortion)} numbers: give k1, k2, p1, p2, and k3 if there is one")
    if max(map(abs, distortion[2:4])) > LARGEST_TANGENTIAL:
        raise ValueError(
            f"distortion has p1 {distortion[2]:g} and p2 {distortion[3]:g}, but every lens is under "
            f"{LARGEST_TANGENTIAL:g}: give the numbers in the order k1, k2, p1, p2, k3"
        )


@dataclass(frozen=True)
class ToolEnvelope:
    """Three cylinders that enclose the tool for collision checks.

    They are in its EE frame: origin in the face's centre, z the face's normal, x towards the handle's butt. The head's
    cylinder is around z, from the face back to -head_length. The claw's is parallel to it at x = claw_radius / 2,
    behind the handle. The handle's is parallel to x.
    """

    __pydantic_config__ = STRICT
    head_radius: Annotated[float, Metres(0.005, 0.1)]
    """Radius of the head."""
    head_length: Annotated[float, Metres(0.02, 0.5)]
    """Length of the head from face to claw."""
    claw_radius: Annotated[float, Metres(0.005, 0.3)]
    """Radius of the claw, which curls towards the handle."""
    handle_radius: Annotated[float, Metres(0.005, 0.1)]
    """Radius of the handle."""
    handle_depth: Annotated[float, Metres(0.002, 0.3)]
    """Distance of the handle's axis behind the face."""
    handle_length: Annotated[float, Metres(0.05, 1.0)]
    """Length of the handle from the face's centre."""

    def __post_init__(self) -> None:
        if self.handle_depth >= self.head_length:
            raise ValueError(f"handle_depth {self.handle_depth} must be less than head_length {self.head_length}")


@dataclass(frozen=True)
class SceneConfig:
    """Obstacles in the station, and the arm's home posture, handover pose and workspace.

    Boxes are axis-aligned in `base`, but for `obstacles`.
    """

    __pydantic_config__ = STRICT
    table_size: tuple[Extent, Extent]
    """Size of the table, x and y."""
    table_center: tuple[Place, Place]
    """Middle of the table in `base`, x and y."""
    table_height: Annotated[float, Metres(-3.0, 3.0)]
    """Height of the table's top above the base plane: 0 if the arm stands on the table, negative if it stands on a
    pedestal.
    """
    camera_size: tuple[Extent, Extent, Extent]
    """Size of the box around the camera's centre."""
    person_center: Point
    """Centre, in `base`, of the box where the person stands in a handover. The arm never enters it."""
    person_size: tuple[Extent, Extent, Extent]
    """Size of the person's box."""
    home: JointAngles
    """Joint positions where the arm waits and parks, base to wrist 3. The pendant shows degrees: multiply them by
    0.0174533.
    """
    handover_position: Point
    """Position of the palm's origin at the handover, in `base`."""
    handover_facing: Direction
    """Direction of the palm at the handover, towards the person, in `base`; any length."""
    workspace_lower: Point
    """Lower corner of the box that flange, hand and tool may not leave, in `base`."""
    workspace_upper: Point
    """Upper corner of the box that flange, hand and tool may not leave, in `base`."""
    obstacles: tuple[Obstacle, ...] = ()
    """Further boxes that arm, hand and tool avoid: name, center, size and rotation of each."""

    def __post_init__(self) -> None:
        names = [*BODY_NAMES, *(obstacle.name for obstacle in self.obstacles)]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"each obstacle needs its own name: {', '.join(twice)} is used twice")
        if np.linalg.norm(self.handover_facing) < 1e-6:
            raise ValueError("handover_facing is not a direction: give a vector from the palm towards the person")
        if np.any(np.asarray(self.workspace_lower) >= np.asarray(self.workspace_upper)):
            raise ValueError("workspace_lower must be below workspace_upper in x, y and z")


CAMERA = "camera"
"""Section of a station file with the camera."""
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
