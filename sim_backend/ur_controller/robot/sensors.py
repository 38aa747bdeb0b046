"""The sensors of the arm: joints and wrench, with the errors of the controller's profile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import exp, sqrt

import numpy as np

from toolee_robot.frames import Array, cross
from toolee_robot.sim_backend.ur_controller.profile import IDEAL, EncoderNoise, ForceErrors, Profile
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import ArmDynamics, Dynamics
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel, Plant
from toolee_robot.sim_backend.ur_controller.robot.registers import Registers

BLOCK = 1024


class Noise:
    """Standard normal vectors of six.

    Args:
        seed: Seed; equal seeds give equal vectors.
    """

    def __init__(self, seed: int | Sequence[int]) -> None:
        self._rng = np.random.default_rng(seed)
        self._block, self._next = self._rng.standard_normal((BLOCK, 6)), 0

    def vector(self) -> Array:
        """The next vector, (6,)."""
        if self._next == BLOCK:
            self._block, self._next = self._rng.standard_normal((BLOCK, 6)), 0
        self._next += 1
        return np.asarray(self._block[self._next - 1])


FRICTION_SPEED = 0.05  # [rad/s] at which the missed friction has three quarters of its full size
DAMPING = 0.1  # of the wrench that joint torques are taken for, so that it stays finite near singularities
_DAMPED = DAMPING**2 * np.eye(6)


class WrenchErrors:
    """Error of the wrench at the flange from tick to tick.

    Offset and drift turn with the flange, as those of a sensor there do.

    Args:
        model: The robot's model.
        errors: Sizes of the errors.
        noise: Random numbers.
    """

    def __init__(self, model: ControllerModel, errors: ForceErrors, noise: Noise) -> None:
        self._errors, self._noise = errors, noise
        self._torque = np.array(model.torque)
        self._keep = exp(-model.period / errors.correlation) if errors.correlation > 0.0 else 0.0
        self._sd = np.repeat(errors.noise, 3)
        self._fluctuation = self._sd * noise.vector()
        self._offset = _along(errors.offset, noise)
        self._warming = _along(errors.time_drift, noise)
        self._pose_drift = np.repeat(errors.pose_drift, 3)
        self._waves = np.array([noise.vector() for _ in range(6)]) * 0.5  # [1/rad] of each axis over the joints
        self._phase = 2.0 * np.pi * noise.vector()
        self._time = 0.0

    def step(self, dt: float, q: Array, qd: Array, dynamics: Dynamics) -> tuple[Array, Array]:
        """Advance by one tick.

        Args:
            dt: Length of the tick [s].
            q: Joint positions, (6,) [rad].
            qd: Joint velocities, (6,) [rad/s].
            dynamics: Torques and geometry of the set-point's motion.

        Returns:
            The steady part of the error and its noise, (6,) [N, Nm] each, base axes.
        """
        errors = self._errors
        self._time += dt
        fresh = sqrt(1.0 - self._keep * self._keep)
        self._fluctuation = self._keep * self._fluctuation + fresh * self._sd * self._noise.vector()
        drift = self._pose_drift * np.sin(self._waves.dot(q) + self._phase)
        slow = self._offset + drift + (1.0 - exp(-self._time / errors.warm_up)) * self._warming
        links = dynamics.links
        turned = np.array((slow, self._fluctuation)).reshape(4, 3).dot(links.X_base_flange[:3, :3].T)
        wrench, noise = turned.reshape(2, 6)
        if errors.friction > 0.0 or errors.inertia > 0.0:
            missed = errors.friction * self._torque * np.tanh(qd / FRICTION_SPEED)
            missed += errors.inertia * dynamics.acceleration
            J = links.flange_jacobian
            wrench += np.linalg.solve(J.dot(J.T) + _DAMPED, J.dot(missed))
        return wrench, noise


def _along(norms: tuple[float, float], noise: Noise) -> Array:
    """A force and a torque of these norms in random directions, (6,)."""
    directions = noise.vector()
    force, torque = (
        norm * d / np.linalg.norm(d) for norm, d in zip(norms, (directions[:3], directions[3:]), strict=True)
    )
    return np.concatenate([force, torque])


class ForceSensor:
    """Wrench of the environment at the flange's origin.

    Args:
        sensors: The sensors of the arm.
        registers: General purpose registers.
        zeroed: Whether the controller can zero it.

    Attributes:
        external: Whether the wrench comes from RTDE's external_force_torque.
    """

    def __init__(self, sensors: Sensors, registers: Registers, zeroed: bool) -> None:
        self.external = False
        self._sensors, self._registers, self._zeroed = sensors, registers, zeroed
        self._bias = np.zeros(6)  # flange axes

    def wrench(self, R: Array) -> Array:
        """The wrench.

        Args:
            R: Orientation of the flange in the base, (3, 3).

        Returns:
            Force and torque, (6,) [N, Nm], base axes.
        """
        return self._felt(R) - _turned(R, self._bias)

    def push(self, R: Array) -> Array:
        """What moves the arm in freedrive: the client's wrench where there is one, else `Sensors.push`; as `wrench`."""
        return self._felt(R) if self.external else self._sensors.push

    def zero(self, R: Array) -> None:
        """Take the present wrench for zero, free of its noise, as a mean would; `R` as for `wrench`."""
        if self._zeroed:
            self._bias = _turned(R.T, self._felt(R) - self._sensors.fluctuation)

    def _felt(self, R: Array) -> Array:
        if self.external:
            return _turned(R, np.array(self._registers.external_force_torque))
        return self._sensors.wrench


def _turned(R: Array, wrench: Array) -> Array:
    return np.concatenate([R @ wrench[:3], R @ wrench[3:]])


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
