"""A hammer in a compliant, slipping grip behind a wrist that yields, carried onto a nail: what both engines build.

The carriage moves straight down at the speed of the strike, and brakes after the contact. The palm turns on it about a
wrist with a limited torque. The handle lies along x, the face meets the nail at the origin.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array
from toolee_robot.sim_backend.physics.grip import GripLimits
from toolee_robot.sim_backend.physics.wood import NailSpec
from toolee_robot.tools import Tool

CARRIAGE_MASS, PALM_MASS, PALM_INERTIA = 50.0, 1.0, 4e-3  # [kg], [kg], [kg m^2]
WRIST_TO_GRIP = 0.10  # [m]
WRIST_GAIN = 12.0  # [1/s]
WRIST_STIFFNESS = 60.0  # [N m s/rad] of MuJoCo's servo of the wrist's velocity, up to the torque's limit
GRIP_WIDTH = 0.08  # [m] of the hand along the handle
FACE_DROP = 0.03  # [m] of the face under the handle's axis
GAP = 0.004  # [m] between face and nail at the start
FOLLOW_THROUGH = 0.004  # [s] after the contact at which the carriage begins to brake
BRAKING = 30.0  # [m/s^2]
DURATION = 0.16  # [s]
SWING = 10.0  # [m/s^2] acceleration of the carriage between two strikes
LIFT = 0.6  # [m/s] at most, upwards


@dataclass(frozen=True)
class Hammer:
    """A hammer."""

    mass: float = 0.7
    moments: tuple[float, float, float] = (4e-4, 4e-3, 4e-3)
    balance: float = 0.17
    reach: float = 0.20


@dataclass(frozen=True)
class Rig:
    """A held strike."""

    hammer: Hammer = field(default_factory=Hammer)
    speed: float = 1.2
    limits: GripLimits = field(default_factory=lambda: GripLimits.from_contact(100.0, 0.9, 0.014, GRIP_WIDTH))
    wrist_torque: float = 3.3
    eccentricity: float = 0.0
    sideways: float = 0.0
    spec: NailSpec = field(default_factory=NailSpec)

    @classmethod
    def of(cls, tool: Tool, limits: GripLimits, wrist_torque: float, speed: float, sideways: float) -> Rig:
        """The rig for a tool of the catalogue, held at its grip."""
        moments = np.linalg.eigvalsh(tool.inertia)
        hammer = Hammer(
            tool.mass, (float(moments[0]), float(moments[1]), float(moments[2])), float(tool.center_of_mass[2]),
            float(tool.ee(Category.HAMMER_HEAD).X_tool_ee[2, 3]),
        )  # fmt: skip
        return cls(hammer, speed, limits, wrist_torque, sideways=sideways)

    def carriage_speed(self, time: float) -> float:
        """Downward speed [m/s] of the carriage at `time` [s] after the start."""
        braking = max(0.0, time - GAP / self.speed - FOLLOW_THROUGH) * BRAKING
        return max(0.0, self.speed - braking)


@dataclass(frozen=True)
class HeldStrike:
    """What one held strike does."""

    driven: float
    along: float
    across: float
    tilt: float
    left: float
    rebound: float
    yielded: float
    spin: float = 0.0
    lost: bool = False
    finite: bool = True

    @property
    def row(self) -> Array:
        """Drive, slips [mm], tilts [deg], rebound [m/s], wrist [deg], (7,)."""
        lengths = 1e3 * np.array([self.driven, self.along, self.across])
        tilts = np.rad2deg([self.tilt, self.left])
        return np.array([*lengths, *tilts, self.rebound, np.rad2deg(self.yielded)])
