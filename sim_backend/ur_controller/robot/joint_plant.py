"""Six ideal joints: a plant without a world."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel


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
