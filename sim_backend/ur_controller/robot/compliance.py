"""Force mode and freedrive: the TCP gives way along chosen axes, on top of whatever the motion does along the others.

The stand-in's own law, an admittance: along a compliant axis the TCP moves at (wanted + felt wrench) times a
mobility, reached with a time constant. Universal Robots publishes none.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot.cartesian import joint_speeds, tcp_twist
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel

MOBILITY = np.array([2e-3] * 3 + [5e-2] * 3)
"""[m/s/N], [rad/s/Nm] in force mode with a gain of 1."""
FREEDRIVE_GAIN = 5.0
TIME_CONSTANT = 0.05  # [s]


@dataclass
class Compliance:
    """R: 3x3 axes of the task frame in the base. axes (6,): 1 compliant, 0 as commanded, task frame. wrench (6,)
    [N, Nm]: what the arm shall exert on the environment, task frame. speed (6,): the most along a compliant axis
    [m/s], [rad/s]."""

    R: Array
    axes: Array
    wrench: Array
    speed: Array
    gain: float
    _twist: Array = field(default_factory=lambda: np.zeros(6))

    def apply(self, model: ControllerModel, X_flange_tcp: Array, q: Array, qd: Array, felt: Array, dt: float) -> Array:
        """qd (6,) [rad/s] instead of the commanded qd at the set-point q; felt (6,): wrench on the TCP, base axes."""
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = self.R
        wanted = self.gain * MOBILITY * (self.wrench + turn.T @ felt)
        self._twist += (np.clip(wanted, -self.speed, self.speed) - self._twist) * min(dt / TIME_CONSTANT, 1.0)
        commanded = turn.T @ tcp_twist(model, q, X_flange_tcp, qd)
        twist = np.where(self.axes != 0, self._twist, commanded)
        limit = np.array(model.velocity)
        return np.clip(joint_speeds(model, q, X_flange_tcp, turn @ twist), -limit, limit)
