"""The sensors of the arm: measured joints and wrench, with the errors of the controller's profile."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from toolee_robot.frames import Array, cross
from toolee_robot.sim_backend.ur_controller.profile import IDEAL, EncoderNoise, ForceErrors, Profile
from toolee_robot.sim_backend.ur_controller.robot.dynamics import ArmDynamics, Dynamics
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel
from toolee_robot.sim_backend.ur_controller.robot.plant import Plant
from toolee_robot.sim_backend.ur_controller.robot.sensing.force_errors import WrenchErrors
from toolee_robot.sim_backend.ur_controller.robot.sensing.noise import Noise


@dataclass
class PayloadError:
    """A mass at the flange that the controller does not know; a fault.

    Attributes:
        mass: Mass [kg]; negative where the arm carries less than the controller takes for granted.
        cog: Centre of gravity, flange frame, (3,) [m].
    """

    mass: float = 0.0
    cog: Array = field(default_factory=lambda: np.zeros(3))


class Sensors:
    """Measured joints and wrench: those of the plant, with the errors of the latest tick.

    Args:
        model: The robot's model.
        plant: What is measured.
        profile: The controller's profile.
        seed: Seed of all noise.

    Attributes:
        fluctuation: The part of the wrench that is noise, (6,) [N, Nm], base axes.
        unknown_weight: The part of the wrench that is `payload_error`'s weight, (6,) [N, Nm], base axes.
        dynamics: Torques, momentum and geometry of the set-point's motion; None where nothing needs them.
        payload_error: Mass that the controller does not know; a fault.
    """

    def __init__(self, model: ControllerModel, plant: Plant, profile: Profile, seed: int) -> None:
        self.fluctuation, self.unknown_weight = np.zeros(6), np.zeros(6)
        self.dynamics: Dynamics | None = None
        self.payload_error = PayloadError()
        self._plant, self._profile, self._noise = plant, profile, Noise(seed)
        self._arm = ArmDynamics(model)
        self._q_error, self._qd_error, self._wrench_error = np.zeros(6), np.zeros(6), np.zeros(6)
        self._encoders, self._errors = profile.encoders, self._wrench_errors(model, profile.force)

    @property
    def q(self) -> Array:
        """Measured joint positions, (6,) [rad]."""
        return self._plant.q + self._q_error

    @property
    def qd(self) -> Array:
        """Measured joint velocities, (6,) [rad/s]."""
        return self._plant.qd + self._qd_error

    @property
    def wrench(self) -> Array:
        """Measured wrench of the environment at the flange's origin, (6,) [N, Nm], base axes, not zeroed."""
        return self._plant.wrench + self._wrench_error

    @property
    def push(self) -> Array:
        """What moves the arm in freedrive: wrench of the environment and of what the controller does not know to carry.

        As `wrench`, free of the reading's own errors: freedrive balances joint torques, and the gearboxes' friction
        holds the arm against what little those are off (assumed; nothing is published).
        """
        return self._plant.wrench + self.unknown_weight

    def set_noise(self, model: ControllerModel, encoders: EncoderNoise | None, force: ForceErrors | None) -> None:
        """Set the noise; a fault, or its end.

        Args:
            model: The robot's model.
            encoders: Noise of the joints; the profile's if None.
            force: Errors of the wrench; the profile's if None.
        """
        self._encoders = self._profile.encoders if encoders is None else encoders
        self._errors = self._wrench_errors(model, self._profile.force if force is None else force)

    def _wrench_errors(self, model: ControllerModel, force: ForceErrors) -> WrenchErrors | None:
        return None if force == ForceErrors() else WrenchErrors(model, force, self._noise)

    def step(
        self, model: ControllerModel, q_target: Array, payload: float, cog: Array, gravity: Array, dt: float
    ) -> None:
        """Draw the errors of a tick, at its end.

        Args:
            model: The robot's model, with its DH parameters.
            q_target: Set-point, (6,) [rad].
            payload: Mass that the controller takes for its payload [kg].
            cog: Its centre of gravity, flange frame, (3,) [m].
            gravity: Acceleration of the base that is equivalent to gravity, (3,) [m/s^2].
            dt: Length of the tick [s].
        """
        unknown = self.payload_error.mass != 0.0
        self.dynamics = None
        if self._profile.name != IDEAL.name or self._errors is not None or unknown:
            self.dynamics = self._arm.step(model, q_target, payload, cog, gravity, dt)
        encoders, noise = self._encoders, self._noise
        self._q_error = encoders.position * noise.vector() if encoders.position > 0.0 else np.zeros(6)
        self._qd_error = encoders.velocity * noise.vector() if encoders.velocity > 0.0 else np.zeros(6)
        self._wrench_error, self.fluctuation, self.unknown_weight = np.zeros(6), np.zeros(6), np.zeros(6)
        if self.dynamics is None:
            return
        if unknown:
            weight = -self.payload_error.mass * gravity
            arm = self.dynamics.links.X_base_flange[:3, :3] @ self.payload_error.cog
            self.unknown_weight = self._wrench_error = np.concatenate([weight, cross(arm, weight)])
        if self._errors is not None:
            steady, self.fluctuation = self._errors.step(dt, self._plant.q, self._plant.qd, self.dynamics)
            self._wrench_error = self._wrench_error + steady + self.fluctuation
