"""Errors of what a person measures in a cell: how what a job is told differs from what is there.

Each group of errors has a random stream of its own, and a size only scales what is drawn: with another size of one
error the others are as before, so that trials of the same seed are paired.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.record import rows
from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, transform
from toolee_robot.robots import load_robot
from toolee_robot.sim_backend.options import InHandOffset, SimOptions
from toolee_robot.station import StationConfig, ToolData
from toolee_robot.station.schema import STRICT, NotNegative
from toolee_robot.tools import Tool
from toolee_robot.types import DhCalibration, HandWeight
from toolee_robot.types.arm import Six


@dataclass(frozen=True)
class CellErrors:
    """Sizes of the errors: standard deviations, along each axis where there are several. The defaults are nominal."""

    __pydantic_config__ = STRICT
    camera_position: NotNegative = 0.002
    """Of the camera's place [m]: eye-to-hand calibrations are off by 0.7 to 3.2 mm at 1 m
    (docs/results/calibration.md has this project's)."""
    camera_rotation: NotNegative = float(np.deg2rad(0.3))
    """Of the camera's orientation [rad]; assumed."""
    nail_beside: NotNegative = 0.001
    """Of the nail's place beside its axis [m]: a punched mark and a ruler; assumed."""
    nail_height: NotNegative = 0.0003
    """Of the height of the wood's top [m]: touched with a known tip; assumed."""
    nail_lean: NotNegative = float(np.deg2rad(2.0))
    """Of the nail's lean to each side [rad], which the job takes for upright: set by hand; assumed."""
    ruler: NotNegative = 0.001
    """Of a length that is measured on the tool [m]; of the handle's radius half as much (a calliper). Assumed."""
    face_angle: NotNegative = float(np.deg2rad(1.0))
    """Of the direction in which the face looks [rad]; assumed."""
    scales: NotNegative = 0.01
    """Of the tool's mass, as a share of it: kitchen scales; assumed."""
    balance: NotNegative = 0.005
    """Of the centre of mass along the handle [m], found by balancing it; assumed."""
    kinematics: NotNegative = 0.0002
    """Of each Denavit-Hartenberg length [m] and angle [rad] of the arm: what its factory's calibration leaves, some
    0.6 mm at the flange; assumed."""
    wood: NotNegative = 0.1
    """Of the wood's specific gravity, as a share of it: coefficient of variation within a species (Forest Products
    Laboratory, Wood Handbook, FPL-GTR-282, table 5-6). Its resistance varies by 2.5 times as much."""
    friction: NotNegative = 0.1
    """Of the coefficient of friction between hand and handle, as a share of it; assumed."""
    payload: NotNegative = 0.1
    """Of the mass of what hangs on the flange without a tool (hand, adapter, cables' share), as a share of it;
    assumed."""
    wrench: NotNegative = 1.0
    """Of the wrench that the arm reports: noise, offset, drift and what its estimate misses in motion, as a share of
    those of the arm's generation (sim_backend/ur_controller/profile.py: 3.6 N of noise and 7 N of offset for a CB3, 1.5
    N and 4 N for an e-Series)."""
    compliance: NotNegative = 1.0
    """Of the arm's joints, as a share of the nominal one (sim_backend/physics/robot_body.py): 6.7e4, 3.1e4 and 1.0e4
    Nm/rad by the joint's size, from catalogues of gears of such torques. Steps bound how stiff a joint can be, other
    than by 0."""
    handover: NotNegative = 1.0
    """Of the pose in which the hammer is laid into the hand, as a share of its range (sim_backend/options.py): 30 mm
    along the handle, 25 deg about it, 12 deg of each tilt, to both sides; assumed."""
    other_tool: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """How far the tool's data, before ruler, scales and balance err, are those of another hammer of its kind, which the
    seed draws: 0 for its own, 1 for the other one's."""


MOST_NAILS = 64
"""Number of nails that lean, each for itself."""
NOMINAL = CellErrors()
"""What a careful person's measurements are off by."""
EXACT = replace(CellErrors(*(0.0 for _ in fields(CellErrors))), handover=NOMINAL.handover)
"""No errors: the job is told what is there. How the hammer lies in the hand nobody tells it."""


@dataclass(frozen=True, eq=False)
class DrawnErrors:
    """The errors of one cell.

    Attributes:
        camera: Camera's place [m] and orientation as a rotation vector [rad], axes of `base`, (6,).
        nail: Nail's place, and height of the wood's top, (3,) [m].
        leans: Leans of the nails in their order, x and y of a rotation vector in the upright nail's axes, (n, 2) [rad].
        tool: Standard normal numbers of the tool's data: radius, face (3), normal (3), mass, balance, (9,).
        arm: Standard normal numbers of the arm's kinematics: theta, a, d, alpha of the six joints, (4, 6).
        material: Standard normal numbers of the wood and of the friction in the hand, (2,).
        hand: Standard normal number of the hand's mass.
        offset: How the hammer is laid into the hand.
        other_tool: Seed of the other hammer whose data the job may be told.
        sizes: Their sizes.
        known_camera: Whether the camera's error is that of the calibration that the job is told, and not drawn here.
    """

    camera: Array
    nail: Array
    leans: Array
    tool: Array
    arm: Array
    material: Array
    hand: float
    offset: InHandOffset
    other_tool: int
    sizes: CellErrors
    known_camera: bool = False

    def displaced(self, config: StationConfig) -> StationConfig:
        """Displace camera and nail of a station, and the kinematics of its arm, by the errors.

        Args:
            config: The station, as it is or as it is believed to be.

        Returns:
            The other one. The camera's displaced pose is given as a calibration's.
        """
        X = config.camera.X_base_camera
        X = transform(
            Rotation.from_rotvec(self.camera[3:]) * Rotation.from_matrix(X[:3, :3]), X[:3, 3] + self.camera[:3]
        )
        work = config.work.moved(*_three(self.nail))
        arm = replace(config.arm, calibration=self._miscalibrated(config.arm.calibration))
        return replace(config, camera=replace(config.camera, pose=rows(X)), work=work, arm=arm)

    def made_of(self, config: StationConfig) -> StationConfig:
        """What the cell is really made of, which nobody tells the job.

        Args:
            config: The cell, with the wood that a person takes it for.

        Returns:
            The cell with the wood that it has.
        """
        gravity = config.work.wood_specific_gravity * _share(self.sizes.wood * float(self.material[0]))
        return replace(config, work=replace(config.work, wood_specific_gravity=gravity))

    def weighed(self, config: StationConfig) -> StationConfig:
        """What the job is told of the mass of the hand, or of the mount.

        Args:
            config: The station, with the mass that the hand has.

        Returns:
            The station with the mass that was weighed; the centre of mass stays.
        """
        if not self.sizes.payload:
            return config
        share, hand = _share(self.sizes.payload * self.hand), config.hand
        if hand.mount is not None:
            return replace(config, hand=replace(hand, mount=replace(hand.mount, mass=share * hand.mount.mass)))
        robot = load_robot(config.arm.model, config.arm.calibration, hand)
        true = robot.hand_payload(robot.hand_open)
        return replace(config, hand=replace(hand, weighed=HandWeight(share * true.mass, _three(true.center_of_mass))))

    def _miscalibrated(self, calibration: DhCalibration | None) -> DhCalibration | None:
        """A factory calibration, or none, off by the errors."""
        if not self.sizes.kinematics:
            return calibration
        known = DhCalibration(*((0.0,) * 6,) * 4) if calibration is None else calibration
        deltas = (known.delta_theta, known.delta_a, known.delta_d, known.delta_alpha)
        return DhCalibration(*(_six(d + self.sizes.kinematics * z) for d, z in zip(deltas, self.arm, strict=True)))

    def options(self, usual: SimOptions) -> SimOptions:
        """What no station file says of the cell: nails that lean, hammer and friction in the hand, wrench, joints.

        Args:
            usual: The options without errors.

        Returns:
            The options.
        """
        friction = usual.friction * _share(self.sizes.friction * float(self.material[1]))
        leans = tuple((float(x), float(y)) for x, y in self.leans)
        return replace(
            usual,
            nail_leans=leans,
            offset=self.offset,
            friction=friction,
            wrench_errors=self.sizes.wrench,
            compliance=self.sizes.compliance,
        )

    def measured(self, tool: Tool, name: str) -> ToolData:
        """What a person with ruler, scales and calliper writes down of a hammer.

        Args:
            tool: The hammer.
            name: What the person calls it.

        Returns:
            Its data.
        """
        z, size = self.tool, self.sizes
        sheet = _sheet(tool)
        if size.other_tool:
            # The world, which takes a second to import, is there where a tool is.
            from toolee_robot.sim_backend.station import draw_hammer

            other = draw_hammer(np.random.default_rng(self.other_tool), (tool.kind,))
            sheet = (1.0 - size.other_tool) * sheet + size.other_tool * _sheet(other)
        radius, face, normal, mass, center = sheet[0], sheet[1:4], sheet[4:7], sheet[7], sheet[8:11]
        return ToolData(
            name=name,
            grip_radius=max(5e-3, float(radius) + 0.5 * size.ruler * float(z[0])),
            face=_three(face + size.ruler * z[1:4]),
            face_normal=_three(Rotation.from_rotvec(size.face_angle * z[4:7]).apply(normal)),
            mass=float(mass) * (1.0 + size.scales * float(z[7])),
            center_of_mass=_three(center + np.array([0.0, 0.0, size.balance * float(z[8])])),
        )

    @property
    def facts(self) -> dict[str, float | None]:
        """Figures for a run's summary; None for a camera whose error is its calibration's."""
        place, turn = float(np.linalg.norm(self.camera[:3])), float(np.linalg.norm(self.camera[3:]))
        return {
            "camera_mm": None if self.known_camera else round(1e3 * place, 3),
            "camera_deg": None if self.known_camera else round(float(np.rad2deg(turn)), 3),
            "nail_beside_mm": round(1e3 * float(np.linalg.norm(self.nail[:2])), 3),
            "nail_height_mm": round(1e3 * float(self.nail[2]), 3),
            "nail_lean_deg": round(float(np.rad2deg(np.linalg.norm(self.leans[0]))), 3),
            "face_mm": round(1e3 * self.sizes.ruler * float(np.linalg.norm(self.tool[1:4])), 3),
            "face_deg": round(float(np.rad2deg(self.sizes.face_angle * np.linalg.norm(self.tool[4:7]))), 3),
            "handle_mm": round(5e2 * self.sizes.ruler * float(self.tool[0]), 3),
            "mass_percent": round(100.0 * self.sizes.scales * float(self.tool[7]), 3),
            "balance_mm": round(1e3 * self.sizes.balance * float(self.tool[8]), 3),
            "kinematics_mm": round(1e3 * self.sizes.kinematics * float(np.sqrt(np.mean(self.arm**2))), 3),
            "wood_percent": round(100.0 * self.sizes.wood * float(self.material[0]), 3),
            "friction_percent": round(100.0 * self.sizes.friction * float(self.material[1]), 3),
            "payload_percent": round(100.0 * self.sizes.payload * self.hand, 3),
            "wrench_percent": round(100.0 * self.sizes.wrench, 3),
            "compliance_percent": round(100.0 * self.sizes.compliance, 3),
            "handover_mm": round(1e3 * self.offset.along, 3),
            "handover_spin_deg": round(float(np.rad2deg(self.offset.spin)), 3),
            "handover_tilt_deg": round(float(np.rad2deg(np.hypot(self.offset.tilt_x, self.offset.tilt_y))), 3),
            "other_tool_percent": round(100.0 * self.sizes.other_tool, 3),
        }


def draw_errors(sizes: CellErrors, seed: int, camera_covariance: Array | None = None) -> DrawnErrors:
    """Draw the errors of a cell.

    Args:
        sizes: Their sizes.
        seed: Seed of the job.
        camera_covariance: Covariance of the camera's pose by its calibration's record, (6, 6) [m, rad], axes of `base`,
            instead of the sizes; zeros where the calibration has its own error already; None for the sizes.

    Returns:
        The errors.
    """
    streams = (np.random.default_rng([seed, 31, group]) for group in range(8))
    camera, nail, tool, lean, arm, material, hand, other = streams
    if camera_covariance is None:
        off = camera.normal(size=6) * np.repeat([sizes.camera_position, sizes.camera_rotation], 3)
    else:
        off = camera.multivariate_normal(np.zeros(6), camera_covariance)
    beside = nail.normal(size=3) * [sizes.nail_beside, sizes.nail_beside, sizes.nail_height]
    leaning = sizes.nail_lean * lean.normal(size=(MOST_NAILS, 2))
    return DrawnErrors(
        off,
        beside,
        leaning,
        tool.normal(size=9),
        arm.normal(size=(4, 6)),
        material.normal(size=2),
        float(hand.normal()),
        InHandOffset.of_job(seed, sizes.handover),
        int(other.integers(2**31)),
        sizes,
        known_camera=camera_covariance is not None and not np.any(camera_covariance),
    )


def _sheet(tool: Tool) -> Array:
    """A hammer's exact data: radius of the handle, face, its normal, mass, centre of mass, (11,)."""
    X = tool.ee(Category.HAMMER_HEAD).X_tool_ee
    return np.concatenate([[tool.handle.grip_radius], X[:3, 3], X[:3, 2], [tool.mass], tool.center_of_mass])


def _share(error: float) -> float:
    """1 and a relative error; errors that nobody would overlook are cut."""
    return 1.0 + float(np.clip(error, -0.5, 0.5))


def _six(v: Array) -> Six:
    a, b, c, d, e, f = (float(value) for value in v)
    return a, b, c, d, e, f


def _three(v: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in v)
    return x, y, z
