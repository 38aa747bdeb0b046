"""The two controllers that are stood in for, from `toolee_robot.arm_data`.

Accelerations are not published; those here are the stand-in's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.types import ArmModel


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
    alpha: tuple[float, ...]
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


def _model(model: ArmModel, version: tuple[int, int, int, int]) -> ControllerModel:
    data = ARM_DATA[model]
    return ControllerModel(
        model.value, version, data.rate, data.a, data.d, data.velocity, data.torque, data.payload, data.alpha
    )


UR10 = _model(ArmModel.UR10, (3, 15, 8, 106339))
UR10E = _model(ArmModel.UR10E, (5, 11, 0, 108249))
MODELS = {model.name: model for model in (UR10, UR10E)}
