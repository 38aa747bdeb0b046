"""Facts of the two controllers that are stood in for.

DH parameters: Universal Robots, "DH parameters for calculations of kinematics and dynamics". Joint speeds and torques:
the UR10's and UR10e's technical data. Accelerations are not published; those here are the stand-in's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians


@dataclass(frozen=True)
class ControllerModel:
    """version: major, minor, bugfix, build. rate: of RTDE and of the control loop [Hz]. a, d [m], alpha [rad]: standard
    DH. position: joints may be within +- this [rad]. velocity [rad/s], torque [Nm]: joint limits. payload: most [kg].

    acceleration: no joint speeds up or slows down faster than this while it follows a script [rad/s^2].
    stop_deceleration: of every joint when a program ends in mid-motion. safety_deceleration: the same when the safety
    system stops the arm.
    """

    name: str
    version: tuple[int, int, int, int]
    rate: float
    a: tuple[float, ...]
    d: tuple[float, ...]
    velocity: tuple[float, ...]
    torque: tuple[float, ...]
    payload: float
    alpha: tuple[float, ...] = (pi / 2, 0.0, 0.0, pi / 2, -pi / 2, 0.0)
    position: tuple[float, ...] = (2 * pi,) * 6
    acceleration: float = 40.0
    stop_deceleration: float = 5.0
    safety_deceleration: float = 15.0

    @property
    def e_series(self) -> bool:
        return self.version[0] > 3

    @property
    def period(self) -> float:
        """One tick [s]."""
        return 1.0 / self.rate


_VELOCITY = (radians(120),) * 2 + (radians(180),) * 4
_TORQUE = (330.0, 330.0, 150.0, 56.0, 56.0, 56.0)

UR10 = ControllerModel(
    name="UR10",
    version=(3, 15, 8, 106339),
    rate=125.0,
    a=(0.0, -0.612, -0.5723, 0.0, 0.0, 0.0),
    d=(0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922),
    velocity=_VELOCITY,
    torque=_TORQUE,
    payload=10.0,
)
UR10E = ControllerModel(
    name="UR10e",
    version=(5, 11, 0, 108249),
    rate=500.0,
    a=(0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0),
    d=(0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655),
    velocity=_VELOCITY,
    torque=_TORQUE,
    payload=12.5,
)
MODELS = {model.name: model for model in (UR10, UR10E)}
