"""Errors of the measured wrench: noise, offset, drift, and what an estimate from joint currents misses in motion."""

from __future__ import annotations

from math import exp, sqrt

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import ForceErrors
from toolee_robot.sim_backend.ur_controller.robot.dynamics import Dynamics
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel
from toolee_robot.sim_backend.ur_controller.robot.sensing.noise import Noise

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
