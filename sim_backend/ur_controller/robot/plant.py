"""The interface between the controller and the physics that it controls, the simulated models, and six ideal joints.

The models are from `toolee_robot.arm_data`. Their accelerations are assumptions of the stand-in, since Universal
Robots publishes none.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Protocol

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.frames import Array
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


class Plant(Protocol):
    """Six joints that follow set-points.

    Attributes:
        external_force: Additional wrench at the flange's origin, (6,) [N, Nm], axes of the controller's base; for
            faults and for pushing the arm by hand.
    """

    external_force: Array

    @property
    def q(self) -> Array:
        """Measured joint positions, (6,) [rad]."""

    @property
    def qd(self) -> Array:
        """Measured joint velocities, (6,) [rad/s]."""

    @property
    def wrench(self) -> Array:
        """Wrench of the environment at the flange's origin, (6,) [N, Nm], axes of the controller's base.

        Compensated for the payload's weight and inertia.
        """

    def command(self, q: Array, qd: Array) -> None:
        """Set the set-point that is due at the end of the next `step`.

        Args:
            q: Joint positions, (6,) [rad].
            qd: Joint velocities, (6,) [rad/s].
        """

    def step(self, dt: float) -> None:
        """Advance by dt [s]."""

    def set_payload(self, mass: float, cog: Array) -> None:
        """Set the payload to compensate.

        Args:
            mass: Mass [kg].
            cog: Centre of gravity, flange frame, (3,) [m].
        """


class JointPlant:
    """A `Plant` that reaches its set-point at the end of every step, within the joints' velocity limits.

    The arm is stiff: an external force is measured and moves nothing.

    Args:
        model: The robot's model.
        q: Initial joint positions, (6,) [rad].

    Attributes:
        external_force: Wrench on the flange, (6,) [N, Nm], in the controller's base.
    """

    def __init__(self, model: ControllerModel, q: Array) -> None:
        self.external_force = np.zeros(6)
        self._limit = np.array(model.velocity)
        self._q, self._qd = np.array(q, dtype=np.float64), np.zeros(6)
        self._target, self._speed = self._q, self._qd

    @property
    def q(self) -> Array:
        """Joint positions, (6,) [rad]."""
        return self._q

    @property
    def qd(self) -> Array:
        """Joint velocities, (6,) [rad/s]."""
        return self._qd

    @property
    def wrench(self) -> Array:
        """Wrench on the flange, (6,) [N, Nm]: the external force."""
        return self.external_force.copy()

    def command(self, q: Array, qd: Array) -> None:
        """See `Plant`."""
        self._target, self._speed = np.array(q, dtype=np.float64), np.array(qd, dtype=np.float64)

    def step(self, dt: float) -> None:
        """Advance by dt [s]."""
        way = self._target - self._q
        reach = self._limit * dt * (1.0 + 1e-9)
        if np.all(np.abs(way) <= reach):
            self._q, self._qd = self._target, self._speed
        else:
            way = np.clip(way, -reach, reach)
            self._q, self._qd = self._q + way, way / dt

    def set_payload(self, mass: float, cog: Array) -> None:
        """See `Plant`; the ideal joints have no payload to compensate."""
