"""The force sensor at the flange, with errors, and the stops that the simulated arm makes by itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from toolee_robot.control.motion.touch_force import check_offset
from toolee_robot.frames import Array, cross
from toolee_robot.hal import ZERO_TIME
from toolee_robot.sim_backend.ur_controller.profile import profile
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import (
    UPRIGHT,
    ArmDynamics,
    CollisionDetection,
    Dynamics,
    Measured,
    Planned,
)
from toolee_robot.sim_backend.ur_controller.robot.error_codes import ErrorCode
from toolee_robot.sim_backend.ur_controller.robot.kinematics import chain
from toolee_robot.sim_backend.ur_controller.robot.motion import Brake
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.sim_backend.ur_controller.robot.sensors import Noise, WrenchErrors
from toolee_robot.sim_backend.world import SimWorld
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


GRAVITY = np.array([0.0, 0.0, -9.81])  # [m/s^2]


class FlangeSensor:
    """Mean wrench over a control tick, less the weight and inertia of the payload as a rigid body.

    A yielding wrist, moving fingers and a slipping tool are not rigid and appear as a few N.

    Args:
        world: The simulated world.
        payload: Payload to compensate.
        period: Averaging time [s].
        errors: Errors of the reading; None for an exact one.

    Attributes:
        payload: Payload to compensate.
        period: Averaging time [s].
        offset: What is subtracted from the means to come, (6,) [N, Nm], axes of `base`.
        q_target: Tells the set-point, (6,) [rad], by which the errors are computed.
        watch: Called after each mean with the joints' positions and velocities; None for nobody.
        wrench: Latest mean, (6,): force [N] and torque [Nm] about the flange's origin, axes of `base`.
    """

    def __init__(self, world: SimWorld, payload: Payload, period: float, errors: ReadingErrors | None = None) -> None:
        self.payload = payload
        self.period = period
        self.offset = np.zeros(6)
        self.wrench = np.zeros(6)
        self.q_target: Callable[[], Array] = lambda: world.robot.q_arm_target
        self.watch: Callable[[Array, Array], None] | None = None
        self._world, self._errors = world, errors
        hand = world.robot.robot.hand
        self._X_flange_root = hand.X_flange_root
        inertial = hand.tree.links[0].inertial
        assert inertial is not None, "every hand model has a root link with a mass"
        self._R_flange_com = hand.X_flange_root[:3, :3] @ inertial.X_link_com[:3, :3]
        self._impulses: list[list[float]] = []  # of the steps since the last mean, (6,) each
        self._time = 0.0
        self._velocity = self._payload_velocity()[0]
        world.after_step.append(self._add)

    def _add(self) -> None:
        dt = self._world.time_step
        self._impulses.append([dt * value for value in self._world.robot.sensor_reaction()])
        self._time += dt
        if self._time > self.period - 1e-9:
            self._finish()

    def begin(self) -> None:
        """Start a new mean now, so that it coincides with a control tick."""
        self._impulses, self._time = [], 0.0
        self._velocity = self._payload_velocity()[0]

    def zero(self) -> None:
        """Let the world advance by ZERO_TIME, and subtract the mean wrench of that time from all to come.

        Raises:
            DeviceError: The force is too large for an offset.
        """
        means = []
        self.begin()
        for _ in range(round(ZERO_TIME / self.period)):
            self._world.advance(self.period)
            means.append(self.wrench + self.offset)
        mean = np.mean(means, axis=0)
        check_offset(mean)
        self.offset = mean
        self.wrench = means[-1] - self.offset

    def _finish(self) -> None:
        velocity, lever, R, p_flange_com = self._payload_velocity()
        mean = np.sum(self._impulses, axis=0) / self._time
        inertial = self.payload.mass * ((velocity - self._velocity) / self._time - GRAVITY)
        # pybullet gives the joint's force and torque at the carried link's centre of mass, along its principal axes.
        R_com = R.dot(self._R_flange_com)
        force = R_com.dot(mean[:3])
        carried = np.concatenate([force, R_com.dot(mean[3:]) + cross(p_flange_com, force)])
        self.wrench = np.concatenate([inertial, cross(lever, inertial)]) - carried - self.offset
        self._impulses, self._time, self._velocity = [], 0.0, velocity
        if self._errors is None and self.watch is None:
            return
        q, qd = self._world.robot.arm_state()
        if self._errors is not None:
            self.wrench += self._errors.step(self.q_target(), q, qd, self.payload)
        if self.watch is not None:
            self.watch(q, qd)

    def _payload_velocity(self) -> tuple[Array, Array, Array, Array]:
        """Motion of the payload and geometry of the flange, axes of `base`.

        Returns:
            Velocity of the payload's centre of mass, (3,) [m/s]; its position from the flange, (3,) [m]; R_base_flange,
            (3, 3); position of the centre of mass of the hand's root link from the flange, (3,) [m].
        """
        X_base_root, com, w, v_com = self._world.robot.sensor_motion()
        R = X_base_root[:3, :3].dot(self._X_flange_root[:3, :3].T)
        flange = X_base_root[:3, 3] - R.dot(self._X_flange_root[:3, 3])
        lever = R.dot(self.payload.center_of_mass)
        return v_com + cross(w, flange + lever - com), lever, R, com - flange


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
