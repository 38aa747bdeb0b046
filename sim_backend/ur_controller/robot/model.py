"""The models that the stand-in simulates, from `toolee_robot.arm_data`.

Accelerations are assumptions of the stand-in, since Universal Robots publishes none.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.types import ArmModel


@dataclass(frozen=True)
class ControllerModel:
    """A model of controller and arm.

    Attributes:
        name: Name of the model.
        version: Version of the software: major, minor, bugfix, build.
        rate: Rate of RTDE and of the control loop [Hz].
        a: Standard DH parameters a, (6,) [m].
        d: Standard DH parameters d, (6,) [m].
        velocity: Joint velocity limits, (6,) [rad/s].
        torque: Joint torque limits, (6,) [Nm].
        payload: Largest payload [kg].
        alpha: Standard DH parameters alpha, (6,) [rad].
        position: Joint position limits, (6,) [rad], in both directions.
        acceleration: Joint acceleration limit while a script runs [rad/s^2].
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

    @property
    def e_series(self) -> bool:
        """Whether it is an e-Series controller."""
        return self.version[0] > 3

    @property
    def period(self) -> float:
        """Period of the control loop [s]."""
        return 1.0 / self.rate


def _model(model: ArmModel, version: tuple[int, int, int, int]) -> ControllerModel:
    data = ARM_DATA[model]
    return ControllerModel(
        model.value, version, data.rate, data.a, data.d, data.velocity, data.torque, data.payload, data.alpha
    )


UR10 = _model(ArmModel.UR10, (3, 15, 8, 106339))
UR10E = _model(ArmModel.UR10E, (5, 11, 0, 108249))
MODELS = {model.name: model for model in (UR10, UR10E)}
