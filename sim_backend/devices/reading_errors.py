"""Errors of the wrench that an arm reports: those of the controller stand-in's harsh profile, without a controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import profile
from toolee_robot.sim_backend.ur_controller.robot.dynamics import UPRIGHT, ArmDynamics, Dynamics
from toolee_robot.sim_backend.ur_controller.robot.model import MODELS
from toolee_robot.sim_backend.ur_controller.robot.sensing.force_errors import WrenchErrors
from toolee_robot.sim_backend.ur_controller.robot.sensing.noise import Noise
from toolee_robot.types import ArmModel, Payload

TURN = np.array([-1.0, -1.0, 1.0, -1.0, -1.0, 1.0])
"""Signs of a wrench's components between `base` and the controller's base, which differ by a half turn about z."""


class ReadingErrors:
    """Noise, offset and drift of the reading, and what an estimate from joint currents misses in motion.

    Their sizes and sources are those of `ur_controller.profile`, for the arm's generation: a CB3 estimates the wrench
    from joint currents, an e-Series has a sensor.

    Args:
        model: The arm's model.
        size: Size of the errors as a share of those of the profile.
        seed: Seed of all that is drawn.
        period: Time between two readings [s].

    Attributes:
        dynamics: Torques, momentum and geometry of the set-point in the latest reading, in the controller's base; None
            before the first.
    """

    def __init__(self, model: ArmModel, size: float, seed: int | Sequence[int], period: float) -> None:
        self._model = replace(MODELS[model.value], rate=1.0 / period)
        force = profile("harsh", self._model.e_series).force
        self._errors = WrenchErrors(self._model, force, Noise(seed))
        self.dynamics: Dynamics | None = None
        self.place()
        self._size, self._period = size, period

    def place(self) -> None:
        """Note that the set-point is put elsewhere, and does not move there."""
        self._arm = ArmDynamics(self._model)

    def step(self, q_target: Array, q: Array, qd: Array, payload: Payload) -> Array:
        """The error of the next reading.

        Args:
            q_target: Commanded joint positions, (6,) [rad].
            q: Joint positions, (6,) [rad].
            qd: Joint velocities, (6,) [rad/s].
            payload: What the arm believes to carry.

        Returns:
            Force [N] and torque [Nm] about the flange's origin, (6,), axes of `base`.
        """
        carried = payload.mass, payload.center_of_mass
        self.dynamics = dynamics = self._arm.step(self._model, q_target, *carried, UPRIGHT, self._period)
        steady, noise = self._errors.step(self._period, q, qd, dynamics)
        return np.asarray(self._size * TURN * (steady + noise))
