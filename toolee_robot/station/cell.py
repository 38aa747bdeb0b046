"""Objects of the station: camera, work, tool and obstacles."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from toolee_robot.calibration.record import Rows
from toolee_robot.frames import Array, frame_from_axes
from toolee_robot.runtime.yaml_files import IN_FILE
from toolee_robot.station.camera_device import CameraDevice
from toolee_robot.station.obstacle import Obstacle
from toolee_robot.station.values import STRICT, Count, Positive
from toolee_robot.types import CameraIntrinsics

BODY_NAMES = ("table", "stand", "block", "camera", "person")
"""Names of the bodies that every station has."""
COEFFICIENTS = (4, 5)
"""How many numbers a lens's distortion has: k1, k2, p1, p2 and, where it has one, k3."""
LARGEST_TANGENTIAL = 0.05
"""Largest tangential coefficient of a lens: those of real ones are under 0.01."""
VERTICAL = 1e-6
"""Sine of the angle from the vertical up to which position and target tell no level rows of the image."""


@dataclass(frozen=True)
class CameraConfig:
    """Pose and intrinsics of the fixed camera (eye-to-hand).

    The default intrinsics are those of a Kinect v2's depth camera with the colour image registered to it. The pose is
    that of the optical frame (z forward, x right, y down): `X_base_camera`, or `position` and `target`, by which the
    rows of the image are level. A simulated camera stands exactly where these say, whatever a record says.
    """

    __pydantic_config__ = STRICT
    position: tuple[float, float, float] = (0.95, -0.62, 0.85)
    """Optical centre in `base` [m]; left out with `X_base_camera`."""
    target: tuple[float, float, float] = (0.60, -0.15, 0.72)
    """A point on the optical axis, in `base` [m], not straight below `position`; left out with `X_base_camera`."""
    measured_pose: Rows | None = field(default=None, metadata={IN_FILE: "X_base_camera"})
    """Pose of the optical frame in `base` [m] by another calibration program, instead of `position` and `target`: four
    rows of four numbers, or `{position: [x, y, z], quaternion: [x, y, z, w]}`."""
    fx: Positive = 365.5
    """Focal length along x [px]."""
    fy: Positive = 365.5
    """Focal length along y [px]."""
    cx: float = 254.9
    """Principal point, x [px]."""
    cy: float = 205.4
    """Principal point, y [px]."""
    width: Count = 512
    """Width of the image [px]."""
    height: Count = 424
    """Height of the image [px]."""
    distortion: tuple[float, ...] | None = None
    """Distortion of the lens by OpenCV's model: k1, k2, p1, p2 and, where it has one, k3 [1]; all 0 where the driver's
    images are undistorted, null where the camera tells its own, or nobody knows it."""
    intrinsics_record: str | None = field(default=None, metadata={IN_FILE: "intrinsics"})
    """Record of `toolee calibrate intrinsics`, which gives the seven fields above and holds instead of what the camera
    tells of itself; its place is relative to the station file's."""
    lens_serial: str | None = field(default=None, metadata={IN_FILE: ""})
    """Serial number of the camera in that record; null without one."""
    device: CameraDevice | None = None
    """The camera itself, for its driver; null for the simulated one."""
    pose: Rows | None = field(default=None, metadata={IN_FILE: ""})
    """X_base_camera of the calibration's record, 4 x 4, which then holds instead of what was measured; null without a
    record, which a station file names in `calibration`."""

    def __post_init__(self) -> None:
        z = np.subtract(self.target, self.position)
        if self.measured_pose is None and np.hypot(z[0], z[1]) <= VERTICAL * np.linalg.norm(z):
            raise ValueError(
                "target lies on the vertical through position, which leaves open how the image is turned about the "
                "optical axis: give X_base_camera instead of both"
            )
        if self.distortion is not None:
            _check_distortion(self.distortion)

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
        raise ValueError(f"distortion has {len(distortion)} numbers: give k1, k2, p1, p2, and k3 where there is one")
    if max(map(abs, distortion[2:4])) > LARGEST_TANGENTIAL:
        raise ValueError(
            f"distortion has p1 {distortion[2]:g} and p2 {distortion[3]:g}, which are under {LARGEST_TANGENTIAL:g} in "
            "every lens: give the numbers in the order k1, k2, p1, p2, k3"
        )


@dataclass(frozen=True)
class ToolEnvelope:
    """Three cylinders that enclose the tool for collision checks.

    They are in its EE frame: origin in the face's centre, z the face's normal, x towards the handle's butt. The head's
    cylinder is around z, from the face back to -head_length. The claw's is parallel to it at x = claw_radius / 2,
    behind the handle. The handle's is parallel to x. The defaults enclose the hammers of the simulation
    (`toolee_robot.tools`).
    """

    __pydantic_config__ = STRICT
    head_radius: Positive = 0.033
    """Radius of the head [m]."""
    head_length: Positive = 0.14
    """Length of the head from face to claw [m]."""
    claw_radius: Positive = 0.05
    """Radius of the claw, which curls towards the handle [m]."""
    handle_radius: Positive = 0.032
    """Radius of the handle [m]."""
    handle_depth: Positive = 0.050
    """Distance of the handle's axis behind the face [m]."""
    handle_length: Positive = 0.36
    """Length of the handle from the face's centre [m]."""

    def __post_init__(self) -> None:
        if self.handle_depth >= self.head_length:
            raise ValueError(f"handle_depth {self.handle_depth} is not within head_length {self.head_length}")


@dataclass(frozen=True)
class SceneConfig:
    """Obstacles in the station, and the arm's home posture, handover pose and workspace.

    Boxes are axis-aligned in `base`, but for `obstacles`.
    """

    __pydantic_config__ = STRICT
    table_size: tuple[Positive, Positive] = (2.0, 2.0)
    """Size of the table, x and y [m]."""
    table_center: tuple[float, float] = (0.4, 0.0)
    """Middle of the table in `base`, x and y [m]."""
    table_height: float = 0.0
    """Height of the table's top over the base plane [m]: 0 where the arm stands on it, negative where the arm stands
    higher, on a pedestal."""
    camera_size: tuple[Positive, Positive, Positive] = (0.16, 0.16, 0.12)
    """Size of the box around the camera's centre [m]."""
    person_center: tuple[float, float, float] = (0.10, -1.15, 0.85)
    """Centre of the box where the person who hands over stands, in `base` [m]; the arm never enters the box."""
    person_size: tuple[Positive, Positive, Positive] = (0.80, 0.40, 1.70)
    """Size of the person's box [m]."""
    home: tuple[float, float, float, float, float, float] = (0.0, -1.9, 1.9, -1.57, -1.57, 0.0)
    """Joint positions where the arm waits and parks, base to wrist 3 [rad]."""
    handover_position: tuple[float, float, float] = (0.40, -0.45, 0.65)
    """Position of the palm's origin at the handover, in `base` [m]."""
    handover_facing: tuple[float, float, float] = (-0.4, -1.0, 0.0)
    """Direction that the palm faces at the handover, towards the person, in `base`; any length."""
    workspace_lower: tuple[float, float, float] = (-1.0, -1.2, 0.05)
    """Lower corner of the box that flange, hand and tool may not leave, in `base` [m]."""
    workspace_upper: tuple[float, float, float] = (1.2, 1.2, 1.6)
    """Upper corner of the box that flange, hand and tool may not leave, in `base` [m]."""
    obstacles: tuple[Obstacle, ...] = ()
    """Further boxes that arm, hand and tool keep clear of: name, center, size and rotation of each."""

    def __post_init__(self) -> None:
        names = [*BODY_NAMES, *(obstacle.name for obstacle in self.obstacles)]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"obstacles need names of their own: {', '.join(twice)} is taken")
        if np.linalg.norm(self.handover_facing) < 1e-6:
            raise ValueError("handover_facing is no direction: give a vector from the palm towards the person")
        if np.any(np.asarray(self.workspace_lower) >= np.asarray(self.workspace_upper)):
            raise ValueError("workspace_lower must be below workspace_upper in x, y and z")
