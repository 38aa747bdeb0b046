"""The cell: camera, work, and what else stands in it. Lengths [m], angles [rad]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from toolee_robot.config.values import STRICT, Count, NotNegative, Positive
from toolee_robot.frames import Array, frame_from_axes, transform
from toolee_robot.types import CameraIntrinsics


@dataclass(frozen=True)
class CameraConfig:
    """The fixed camera (eye-to-hand). The image's up is the base's z; the defaults are a Kinect v2's depth camera."""

    __pydantic_config__ = STRICT
    position: tuple[float, float, float] = (0.95, -0.62, 0.85)
    """Camera centre in `base` [m]."""
    target: tuple[float, float, float] = (0.60, -0.15, 0.72)
    """A point on the optical axis, in `base` [m]."""
    fx: Positive = 365.5
    """Focal length in x [px]."""
    fy: Positive = 365.5
    """Focal length in y [px]."""
    cx: float = 254.9
    """Principal point's x [px]; pixel centres are at integer coordinates."""
    cy: float = 205.4
    """Principal point's y [px]."""
    width: Count = 512
    """Image width [px]."""
    height: Count = 424
    """Image height [px]."""

    @property
    def intrinsics(self) -> CameraIntrinsics:
        return CameraIntrinsics(self.fx, self.fy, self.cx, self.cy, self.width, self.height)

    @property
    def X_base_camera(self) -> Array:
        """4x4, OpenCV axes."""
        z = np.subtract(self.target, self.position)
        x = np.cross(z, [0.0, 0.0, 1.0])
        return frame_from_axes(z=z, x=x, p=self.position)


@dataclass(frozen=True)
class WorkConfig:
    """The block on its stand, and the upright nail in it. Heights are over the base plane, which is the table's top.

    By default 3.7 J drive the nail; a held claw hammer of 0.9 kg at 1.5 m/s, hitting far from its centre of mass, gives
    about 0.45 J a strike.
    """

    __pydantic_config__ = STRICT
    nail_xy: tuple[float, float] = (0.75, 0.10)
    """The nail's place in `base` [m]."""
    stand_height: Positive = 0.20
    """Height of the stand that lifts the block [m]."""
    stand_size: tuple[Positive, Positive] = (0.07, 0.07)
    """The stand's extent in x and y [m]."""
    block_size: tuple[Positive, Positive, Positive] = (0.08, 0.08, 0.06)
    """The wooden block's extent in x, y, z [m]."""
    nail_diameter: Positive = 0.0022
    """Diameter of the nail's shank [m]."""
    nail_length: Positive = 0.030
    """Length of the nail's shank [m]."""
    nail_head_diameter: Positive = 0.006
    """Diameter of the nail's head [m]."""
    nail_protrusion: Positive = 0.020
    """How far the head's top stands over the wood before the first strike [m]."""
    wood_specific_gravity: Annotated[float, Field(gt=0, lt=1.5)] = 0.35
    """Specific gravity of the wood: white pine 0.35, Scots pine 0.42, oak 0.68."""
    pilot_hole_diameter: NotNegative = 0.0015
    """Diameter of the pilot hole [m], 0 for none."""

    def __post_init__(self) -> None:
        if self.nail_protrusion > self.nail_length:
            raise ValueError(f"nail_protrusion {self.nail_protrusion} is more than nail_length {self.nail_length}")
        if self.pilot_hole_diameter >= self.nail_diameter:
            raise ValueError(
                f"pilot_hole_diameter {self.pilot_hole_diameter} leaves nail_diameter {self.nail_diameter} no hold"
            )

    @property
    def wood_height(self) -> float:
        """Height of the block's top over the base plane."""
        return self.stand_height + self.block_size[2]

    def X_base_nail(self, protrusion: float | None = None) -> Array:
        """Pose of the nail at a protrusion [m] (the initial one if None)."""
        z = self.wood_height + (self.nail_protrusion if protrusion is None else protrusion)
        return transform(np.diag([1.0, -1.0, -1.0]), [*self.nail_xy, z])


@dataclass(frozen=True)
class SceneConfig:
    """What else stands in the station, and where the arm waits and takes a tool. Boxes are axis-aligned in `base`."""

    __pydantic_config__ = STRICT
    table_size: tuple[Positive, Positive] = (2.0, 2.0)
    """The table's extent in x and y [m]; its top is the base plane."""
    camera_size: tuple[Positive, Positive, Positive] = (0.16, 0.16, 0.12)
    """Extent of the box around the camera's centre [m]."""
    person_center: tuple[float, float, float] = (0.10, -1.15, 0.85)
    """Centre of the place of the person who hands over [m]."""
    person_size: tuple[Positive, Positive, Positive] = (0.80, 0.40, 1.70)
    """Extent of that place, which the arm never enters [m]."""
    home: tuple[float, float, float, float, float, float] = (0.0, -1.9, 1.9, -1.57, -1.57, 0.0)
    """Joints where the arm waits and is put away [rad]."""
    handover_position: tuple[float, float, float] = (0.40, -0.45, 0.65)
    """The palm's origin when a tool is handed over [m]."""
    handover_facing: tuple[float, float, float] = (-0.4, -1.0, 0.0)
    """Direction that the palm faces then, towards the person."""
    workspace_lower: tuple[float, float, float] = (-1.0, -1.2, 0.05)
    """Lower corner of the box that the flange may not leave [m]."""
    workspace_upper: tuple[float, float, float] = (1.2, 1.2, 1.6)
    """Upper corner of the box that the flange may not leave [m]."""

    def __post_init__(self) -> None:
        if np.linalg.norm(self.handover_facing) < 1e-6:
            raise ValueError("handover_facing is no direction: give a vector from the palm towards the person")
        if np.any(np.asarray(self.workspace_lower) >= np.asarray(self.workspace_upper)):
            raise ValueError("workspace_lower must be below workspace_upper in x, y and z")
