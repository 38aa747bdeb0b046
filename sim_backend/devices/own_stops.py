"""Stops that the simulated arm makes by itself: those of the controller stand-in, without a controller."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.devices.flange_sensor import TURN, ReadingErrors
from toolee_robot.sim_backend.ur_controller.profile import profile
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import (
    CollisionDetection,
    Measured,
    Planned,
)
from toolee_robot.sim_backend.ur_controller.robot.error_codes import ErrorCode
from toolee_robot.sim_backend.ur_controller.robot.kinematics import chain
from toolee_robot.sim_backend.ur_controller.robot.motion import Brake
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.types import ArmModel


class OwnStops:
    """The set-point of the arm's controller, and whether it stops the arm.

    Detection and limits are the controller stand-in's (`CollisionDetection`), once per reading, in motion and at rest:
    those of the harsh profile of the arm's generation where the reading has errors, else those of `ideal`.
    `ur_controller.profile` says what of them is published, measured or assumed. The detection sees the wrench that the
    controller estimates: with its errors, and not zeroed, since a driver's zero is not known to it. The TCP is at the
    flange. Where the reading has errors, the set-point's torques, momentum and geometry are those that the errors are
    computed from, which are of the set-point at the reading's beginning.

    Assumed, since nothing is published: that a controller compares its set-point with the joints on the link's side of
    their gears, as behind the stand-in with elastic joints, so that of the gears' deflection only what the controller
    does not compensate counts. Unlike the stand-in it reads joints without noise, and an e-Series at 125 Hz, where a
    planned torque may jump in 8 ms by no more than the stand-in's may in 2 ms.

    Args:
        model: The arm's model.
        errors: Errors of the reading; None for an exact one.
        q: Set-point at the start, (6,) [rad].
        period: Time between two readings [s].

    Attributes:
        q_target: Set-point at the end of the present period, (6,) [rad].
        q_before: Set-point at its beginning, (6,) [rad].
    """

    def __init__(self, model: ArmModel, errors: ReadingErrors | None, q: Array, period: float) -> None:
        self._model = MODELS[model.value]
        profiled = profile("ideal" if errors is None else "harsh", self._model.e_series)
        self._detection = CollisionDetection(self._model, profiled.limits)
        self._deceleration = profiled.stops.protective
        self._reports = profiled.reports_ratios
        self._errors, self._period = errors, period
        self.place(q)

    @property
    def ratios(self) -> tuple[float, float] | None:
        """Deviation and collision ratios, see `hal.ArmState`; None where the controller does not report them."""
        return (self._detection.deviation_ratio, self._detection.collision_ratio) if self._reports else None

    def place(self, q: Array) -> None:
        """Put the set-point to joint positions q, (6,) [rad], at rest; this is no motion."""
        self.q_before, self.q_target, self._qd = q, q, np.zeros(6)
        if self._errors is not None:
            self._errors.place()

    def move(self, q: Array) -> None:
        """Move the set-point to q, (6,) [rad], during the period that begins."""
        self.q_before, self._qd, self.q_target = self.q_target, (q - self.q_target) / self._period, q

    def braking(self) -> Iterator[Array]:
        """Set-points, (6,) [rad] each, of a protective stop, to be moved to: along the joints' direction."""
        brake = Brake(self._deceleration)
        while not brake.done:
            yield self.q_target + brake.step(self.q_target, self._qd, self._period, self._period)

    def forget(self) -> None:
        """Start again, as once a person has released the stop."""
        self._detection.forget()

    def check(self, wrench: Array, q: Array, qd: Array, payload: float) -> ErrorCode | None:
        """Check a reading.

        Args:
            wrench: Wrench of the environment at the flange's origin, not zeroed, (6,) [N, Nm], axes of `base`.
            q: Joint positions, (6,) [rad].
            qd: Joint velocities, (6,) [rad/s].
            payload: Mass that the arm believes to carry [kg].

        Returns:
            The reason to stop the arm, if there is one.
        """
        dynamics = None if self._errors is None else self._errors.dynamics
        links = chain(self._model, q) if dynamics is None else dynamics.links
        J = links.flange_jacobian
        measured = Measured(q, qd, J.dot(qd), J, TURN * wrench)
        planned = Planned(self.q_target, self._qd, payload, dynamics)
        self.q_before = self.q_target  # unless it moves on
        return self._detection.step(self._period, measured, planned)
