"""Force mode and freedrive: the TCP is compliant along chosen axes and follows the motion along the others.

The stand-in uses an admittance, since Universal Robots publishes no control law: along a compliant axis the TCP moves
at (desired + measured wrench) times a mobility, with a first-order lag.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot.cartesian import joint_speeds, tcp_twist
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel

MOBILITY = np.array([2e-3] * 3 + [5e-2] * 3)
"""Mobility, (6,) [m/s/N, rad/s/Nm], in force mode with a gain of 1."""
FREEDRIVE_GAIN = 5.0
TIME_CONSTANT = 0.05  # [s] of the lag


@dataclass
class Compliance:
    """Settings and state of force mode or freedrive.

    Attributes:
        R: Axes of the task frame in the base, (3, 3).
        axes: 1 for a compliant axis of the task frame, 0 for one that follows the command, (6,).
        wrench: Desired wrench of the arm on the environment, (6,) [N, Nm], task frame.
        speed: Largest speed along a compliant axis, (6,) [m/s, rad/s].
        gain: Factor of the mobility.
    """

    R: Array
    axes: Array
    wrench: Array
    speed: Array
    gain: float
    _twist: Array = field(default_factory=lambda: np.zeros(6))

    def apply(self, model: ControllerModel, X_flange_tcp: Array, q: Array, qd: Array, felt: Array, dt: float) -> Array:
        """Modify commanded joint velocities by the compliance.

        Args:
            model: The robot's model.
            X_flange_tcp: Pose of the TCP in the flange frame, 4x4.
            q: Set-point, (6,) [rad].
            qd: Commanded joint velocities, (6,) [rad/s].
            felt: Measured wrench at the TCP, (6,) [N, Nm], base axes.
            dt: Length of the tick [s].

        Returns:
            Joint velocities, (6,) [rad/s].
        """
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = self.R
        wanted = self.gain * MOBILITY * (self.wrench + turn.T @ felt)
        self._twist += (np.clip(wanted, -self.speed, self.speed) - self._twist) * min(dt / TIME_CONSTANT, 1.0)
        commanded = turn.T @ tcp_twist(model, q, X_flange_tcp, qd)
        twist = np.where(self.axes != 0, self._twist, commanded)
        limit = np.array(model.velocity)
        return np.clip(joint_speeds(model, q, X_flange_tcp, turn @ twist), -limit, limit)
