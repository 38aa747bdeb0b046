"""Six ideal joints: the plant without a world around it."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel


class JointPlant:
    """A `Plant` that is at its set-point at the end of every step, as far as the joints' speed limits allow.

    The arm is stiff: an external force is felt and moves nothing. q (6,) [rad]: where it starts.
    """

    def __init__(self, model: ControllerModel, q: Array) -> None:
        self.external_force = np.zeros(6)
        self._limit = np.array(model.velocity)
        self._q, self._qd = np.array(q, dtype=np.float64), np.zeros(6)
        self._target, self._speed = self._q, self._qd

    @property
    def q(self) -> Array:
        return self._q

    @property
    def qd(self) -> Array:
        return self._qd

    @property
    def wrench(self) -> Array:
        return self.external_force.copy()

    def command(self, q: Array, qd: Array) -> None:
        self._target, self._speed = np.array(q, dtype=np.float64), np.array(qd, dtype=np.float64)

    def step(self, dt: float) -> None:
        way = self._target - self._q
        reach = self._limit * dt * (1.0 + 1e-9)
        if np.all(np.abs(way) <= reach):
            self._q, self._qd = self._target, self._speed
        else:
            way = np.clip(way, -reach, reach)
            self._q, self._qd = self._q + way, way / dt

    def set_payload(self, mass: float, cog: Array) -> None:
        """A stiff arm without a hand weighs nothing and feels nothing of its payload."""
