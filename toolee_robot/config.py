"""The station and the job as frozen dataclasses; YAML only here, validated.

    from toolee_robot.config import StationConfig, load_station
    config = StationConfig()                 # the simulated station of this repository
    config = load_station(Path("lab.yaml"))  # a lab's own: any subset of the fields

Everything a lab measures once stands here: where the camera, the base, the stand and the nail are, what the limits
are, and how the hand holds a tool nominally. Lengths [m], angles [rad].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field

from toolee_robot.frames import Array, frame_from_axes, transform
from toolee_robot.runtime.yaml_files import read_record
from toolee_robot.types import ArmModel, CameraIntrinsics, DhCalibration

_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True)
class CameraConfig:
    """The fixed camera (eye-to-hand). Intrinsics: a Kinect v2's depth camera, colour registered to it.

    position: camera centre in `base`. target: the point it looks at. The image's up is the base's z.
    """

    __pydantic_config__ = _STRICT
    position: tuple[float, float, float] = (0.95, -0.62, 0.85)
    target: tuple[float, float, float] = (0.60, -0.15, 0.72)
    fx: Positive = 365.5
    fy: Positive = 365.5
    cx: float = 254.9
    cy: float = 205.4
    width: Count = 512
    height: Count = 424

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
class CalibrationConfig:
    """Whose calibration this file holds: `camera` stands where it does for one robot, one camera, one day.

    measured_on: ISO 8601 date. robot_serial, camera_serial: of the devices that were calibrated to each other; they
    must be those of the station. residual: root mean square [m] of the board's points on poses held out from the fit,
    at most max_residual. valid_days: after that many days it must be repeated; None where nothing can have moved, as in
    the simulation.
    """

    __pydantic_config__ = _STRICT
    measured_on: str
    robot_serial: str
    camera_serial: str
    residual: NotNegative
    max_residual: Positive = 0.004
    valid_days: Positive | None = 30.0

    def __post_init__(self) -> None:
        try:
            date.fromisoformat(self.measured_on)
        except ValueError as error:
            raise ValueError(f"measured_on {self.measured_on!r} is no date: write it as 2026-11-20") from error

    def problems(self, robot_serial: str, camera_serial: str, today: date) -> list[str]:
        """Why this calibration must not be used with these devices today, one sentence each; empty if it may."""
        found = []
        for what, mine, theirs in (
            ("robot", self.robot_serial, robot_serial),
            ("camera", self.camera_serial, camera_serial),
        ):
            if mine != theirs:
                found.append(f"it is of {what} {mine!r}, the station has {what} {theirs!r}: calibrate this one")
        age = (today - date.fromisoformat(self.measured_on)).days
        if age < 0:
            found.append(f"it was measured on {self.measured_on}, which is still to come: set the clock")
        elif self.valid_days is not None and age > self.valid_days:
            found.append(f"it is {age} days old, {self.valid_days:g} are allowed: calibrate again")
        if self.residual > self.max_residual:
            found.append(
                f"its residual is {self.residual * 1e3:.1f} mm, {self.max_residual * 1e3:.1f} are allowed: calibrate "
                "again with more and steeper poses"
            )
        return found


SIMULATED = "simulated"
"""The serial number of every simulated device."""
SIMULATED_CALIBRATION = CalibrationConfig("2026-01-01", SIMULATED, SIMULATED, 0.0, valid_days=None)


@dataclass(frozen=True)
class WorkConfig:
    """The block on its stand, and the nail. Heights are over the base plane, which is the table's top.

    nail_xy: the nail in `base`. block_size: wood, x, y, z. stand_height: what lifts the block. nail_protrusion: how
    far the head's top stands over the wood before the first strike; nail_diameter and nail_length of the shank.
    nail_head_diameter. The nail stands upright: X_base_nail's z points down, into the wood. wood_specific_gravity:
    white pine 0.35, Scots pine 0.42, oak 0.68. pilot_hole_diameter: drilled before, 0 for none. By default 3.7 J drive
    the nail; a held claw hammer of 0.9 kg at 1.5 m/s, hitting far from its centre of mass, gives about 0.45 J a strike.
    """

    __pydantic_config__ = _STRICT
    nail_xy: tuple[float, float] = (0.75, 0.10)
    stand_height: Positive = 0.20
    stand_size: tuple[Positive, Positive] = (0.07, 0.07)
    block_size: tuple[Positive, Positive, Positive] = (0.08, 0.08, 0.06)
    nail_diameter: Positive = 0.0022
    nail_length: Positive = 0.030
    nail_head_diameter: Positive = 0.006
    nail_protrusion: Positive = 0.020
    wood_specific_gravity: Annotated[float, Field(gt=0, lt=1.5)] = 0.35
    pilot_hole_diameter: NotNegative = 0.0015

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
class ArmLimits:
    """Which arm it is, and what the planner may use: per joint velocity [rad/s], acceleration [rad/s^2] and jerk
    [rad/s^3].

    UR10 data sheet: base and shoulder 120 deg/s, the others 180 deg/s. Accelerations are not public: 15 for strikes
    keeps the elbow, which carries most of a strike here, under 90 % of its 150 Nm (inverse dynamics of arm, hand and a
    0.9 kg hammer while braking; 53 % in the run-up); a common, slower choice is 8. Lower elsewhere. stop_acceleration,
    stop_jerk: of the braking after a contact or a stop. calibration: of this very arm, from its controller's
    calibration.conf; without it the model's nominal kinematics hold, a millimetre or two off."""

    __pydantic_config__ = _STRICT
    model: ArmModel = ArmModel.UR10
    calibration: DhCalibration | None = None
    velocity: tuple[Positive, Positive, Positive, Positive, Positive, Positive] = (2.09, 2.09, 3.14, 3.14, 3.14, 3.14)
    acceleration: Positive = 15.0
    jerk: Positive = 500.0
    stop_acceleration: Positive = 15.0
    stop_jerk: Positive = 1500.0
    transfer_velocity_scale: Annotated[float, Field(gt=0, le=1)] = 0.35
    transfer_acceleration: Positive = 3.0


@dataclass(frozen=True)
class StrikeConfig:
    """How to hit. speed: wanted speed of the face at contact [m/s]: from 1.2 the hand needs some 90 mm to stop, from
    1.5 140 mm, which the hand at a short hammer has not beside the block. run_up: length of the straight run to the
    nail [m]. touch_speed [m/s] and touch_force [N]: the slow guarded approach that measures where the face meets the
    nail; the force must be under what a yielding wrist passes on at a long hammer's end. contact_force [N]: what counts
    as the strike. clearance: least distance of anything to anything but face and nail [m]."""

    __pydantic_config__ = _STRICT
    speed: Positive = 1.2
    run_up: Positive = 0.20
    touch_speed: Positive = 0.03
    touch_force: Positive = 8.0
    contact_force: Positive = 15.0
    clearance: NotNegative = 0.008


@dataclass(frozen=True)
class TaskConfig:
    """When to go on, to look again and to end.

    flush_protrusion: at most this much of the nail over the wood counts as flush [m]. min_progress: a strike that
    drives less has not moved the nail [m]. slip_per_strike, slip_angle_per_strike: standard deviation of how far a tool
    drifts in the hand with a strike [m, rad]; beyond abort_slip or abort_slip_angle between two looks it must be
    gripped again. views: of the first look; views_again: of the later ones, one every strikes_between_looks.
    handover_timeout [s]."""

    __pydantic_config__ = _STRICT
    max_strikes: Count = 40
    flush_protrusion: Positive = 0.001
    min_progress: NotNegative = 0.0002
    slip_per_strike: NotNegative = 0.0015
    slip_angle_per_strike: NotNegative = np.pi / 450
    abort_slip: Positive = 0.015
    abort_slip_angle: Positive = np.pi / 12
    views: Count = 6
    views_again: Count = 4
    strikes_between_looks: Count = 4
    handover_timeout: Positive = 30.0


@dataclass(frozen=True)
class SceneConfig:
    """What else stands in the station, and where the arm waits and takes a tool. Boxes are axis-aligned in `base`.

    table_size: x, y; its top is the base plane. camera_size: box around the camera's centre. person_center and
    person_size: the place of the person who hands over; the arm never enters it. home: joints [rad] where the arm
    waits and is put away. handover_position: the palm's origin when a tool is handed over; handover_facing: the
    direction that the palm faces then, towards the person. workspace_lower, workspace_upper: the box that the flange
    may not leave.
    """

    __pydantic_config__ = _STRICT
    table_size: tuple[Positive, Positive] = (2.0, 2.0)
    camera_size: tuple[Positive, Positive, Positive] = (0.16, 0.16, 0.12)
    person_center: tuple[float, float, float] = (0.10, -1.15, 0.85)
    person_size: tuple[Positive, Positive, Positive] = (0.80, 0.40, 1.70)
    home: tuple[float, float, float, float, float, float] = (0.0, -1.9, 1.9, -1.57, -1.57, 0.0)
    handover_position: tuple[float, float, float] = (0.40, -0.45, 0.65)
    handover_facing: tuple[float, float, float] = (-0.4, -1.0, 0.0)
    workspace_lower: tuple[float, float, float] = (-1.0, -1.2, 0.05)
    workspace_upper: tuple[float, float, float] = (1.2, 1.2, 1.6)

    def __post_init__(self) -> None:
        if np.linalg.norm(self.handover_facing) < 1e-6:
            raise ValueError("handover_facing is no direction: give a vector from the palm towards the person")
        if np.any(np.asarray(self.workspace_lower) >= np.asarray(self.workspace_upper)):
            raise ValueError("workspace_lower must be below workspace_upper in x, y and z")


@dataclass(frozen=True)
class SupervisorConfig:
    """What the supervisor lets pass, on top of the joints' limits.

    handover_speed: of flange and tool [m/s] at most in HANDOVER mode, with a person in reach: the reduced speed of
    ISO 10218-1. unattended_speed: at most in UNATTENDED mode, with nobody in reach; a usual safety setting of a UR arm.
    tracking_error [rad], data_cycles, overruns: of the arm's `MotionWatch`. max_data_age: of the arm's newest reading
    before a motion [s]. early_contact, late_contact: how far before, and beyond, the expected place a strike may meet
    the nail [m]; at 1.2 m/s and 125 Hz the force is felt some 15 mm behind where it began. max_hand_temperature [deg
    C]: a hotter hand gets no further strike. ask_before_swing: whether a person must confirm the first swing of a
    job."""

    __pydantic_config__ = _STRICT
    handover_speed: Positive = 0.25
    unattended_speed: Positive = 1.5
    tracking_error: Positive = 0.05
    data_cycles: Positive = 3.0
    overruns: Count = 3
    max_data_age: Positive = 0.1
    early_contact: Positive = 0.024
    late_contact: Positive = 0.030
    max_hand_temperature: Positive = 65.0
    ask_before_swing: bool = True


@dataclass(frozen=True)
class HandConfig:
    """The hand on the flange."""

    __pydantic_config__ = _STRICT
    model: str = "shadow_right"
    """Name of the hand, one of `toolee_robot.robots.HANDS`."""


@dataclass(frozen=True)
class StationConfig:
    """A whole station. calibration: None where nobody has calibrated it, which no job accepts."""

    __pydantic_config__ = _STRICT
    calibration: CalibrationConfig | None = SIMULATED_CALIBRATION
    camera: CameraConfig = field(default_factory=CameraConfig)
    work: WorkConfig = field(default_factory=WorkConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)
    arm: ArmLimits = field(default_factory=ArmLimits)
    hand: HandConfig = field(default_factory=HandConfig)
    strike: StrikeConfig = field(default_factory=StrikeConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    supervisor: SupervisorConfig = field(default_factory=SupervisorConfig)

    def __post_init__(self) -> None:
        if self.strike.speed > self.supervisor.unattended_speed:
            raise ValueError(
                f"strike.speed {self.strike.speed} is more than supervisor.unattended_speed "
                f"{self.supervisor.unattended_speed}: every strike would be refused"
            )


def load_station(path: Path) -> StationConfig:
    """Read a station from YAML. Raises ConfigError naming every wrong field."""
    return read_record(path, StationConfig, "station")
