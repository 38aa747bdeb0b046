"""The robot that a script commands: set-point, settings, inputs and outputs.

Order of a tick: latch the RTDE inputs; `ScriptRuntime.step(dt)`; `Machine.step(dt)`; safety; publish.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import IDEAL, Profile
from toolee_robot.sim_backend.ur_controller.robot import poses
from toolee_robot.sim_backend.ur_controller.robot.cartesian import Compliance, tcp_twist
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import UPRIGHT
from toolee_robot.sim_backend.ur_controller.robot.kinematics import chain, forward
from toolee_robot.sim_backend.ur_controller.robot.motion import STANDSTILL, Brake, Motion, MotionError, Move
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel, Plant
from toolee_robot.sim_backend.ur_controller.robot.registers import Event, EventKind, Registers, Watchdogs
from toolee_robot.sim_backend.ur_controller.robot.sensors import ForceSensor, Sensors

RATE_SLEW = 4.0  # [1/s] slew rate of the speed scaling when the slider moves or a pause begins
HISTORY = 2.0  # [s] duration of the histories of joints and forces


class Machine:
    """Set-point, settings, inputs and outputs of the robot.

    Args:
        model: The robot's model.
        plant: What the controller moves.
        registers: General purpose registers.
        profile: How the controller follows, measures and stops.
        seed: Seed of the noise of the sensors.

    Attributes:
        model: The robot's model.
        plant: What the controller moves.
        profile: How the controller follows, measures and stops.
        servo_lag: Lag of `servoj`, or None; the profile's, unless a fault changes it.
        sensors: The sensors of the arm.
        force_sensor: The wrench that the controller reports.
        registers: General purpose registers.
        events: Requests of the script, the oldest first; the controller handles them once per tick.
        watchdogs: RTDE watchdogs of the script.
        q_target: Set-point, (6,) [rad].
        qd_target: Velocity of the set-point, (6,) [rad/s].
        qdd_target: Acceleration of the set-point, (6,) [rad/s^2].
        payload: Mass of the payload [kg].
        payload_cog: Centre of gravity of the payload in the flange frame, (3,) [m].
        payload_inertia: Inertia of the payload, (6,) [kg m^2].
        gravity: Acceleration of the base that is equivalent to gravity, (3,) [m/s^2]; points upwards. What the program
            or the installation says.
        felt_gravity: The same as the base really stands, which the tool's accelerometer feels.
        speed_fraction: Position of the speed slider, 0 to 1.
        speed_scaling: Factor by which the controller itself slows motions down, 0 to 1.
        paused: Whether motions slow down to a halt and wait.
        compliance: Force mode or freedrive, or None.
        freedrive: Whether the compliance is freedrive.
        force_gain: Gain of force mode.
        digital_in: Digital inputs.
        digital_out: Digital outputs.
        analog_in: Analog inputs, 0 to 1.
        analog_out: Analog outputs, 0 to 1.
        temperatures: Joint temperatures [deg C].
        history: Measured joint positions, (6,) [rad] each, the newest last.
        force_history: Forces on the TCP, (3,) [N] each, base axes, the newest last.
        X_flange_tcp: Pose of the TCP in the flange frame, 4x4.
    """

    def __init__(
        self,
        model: ControllerModel,
        plant: Plant,
        registers: Registers,
        profile: Profile = IDEAL,
        seed: int = 0,
    ) -> None:
        self.model, self.plant, self.registers, self.profile = model, plant, registers, profile
        self.stops, self.servo_lag = profile.stops, profile.servo
        self.sensors = Sensors(model, plant, profile, seed)
        self.force_sensor = ForceSensor(self.sensors, registers, profile.force.zeroed)
        self.events: deque[Event] = deque()
        self.watchdogs = Watchdogs()
        self.q_target, self.qd_target, self.qdd_target = plant.q.copy(), np.zeros(6), np.zeros(6)
        self.payload, self.payload_cog, self.payload_inertia = 0.0, np.zeros(3), np.zeros(6)
        self.gravity, self.felt_gravity = UPRIGHT.copy(), UPRIGHT.copy()
        self.speed_fraction, self.speed_scaling = 1.0, 1.0
        self.paused = False
        self.compliance: Compliance | None = None
        self.freedrive = False
        self.force_gain = 1.0
        self.digital_in, self.digital_out = [False] * 18, [False] * 18
        self.analog_in, self.analog_out = [0.0] * 4, [0.0] * 4
        self.temperatures = [30.0] * 6
        ticks = round(HISTORY * model.rate)
        self.history: deque[Array] = deque([plant.q], maxlen=ticks)
        self.force_history: deque[Array] = deque(maxlen=ticks)
        self.tcp = np.zeros(6)
        self._motion: Motion | None = None
        self._stop: Motion | None = None  # the last stop that was not requested by the script
        self._held = False  # a script function waits for the motion
        self._running_out: list[Move] = []  # blended moves that have not ended
        self._halt: Brake | None = None  # the safety system's stop, while a motion waits behind it
        self._rate = 1.0
        self._let_go = False  # a script function has ended during its motion, and none has begun since

    # -- settings

    @property
    def tcp(self) -> Array:
        """Pose of the TCP in the flange frame, (6,): position [m], rotation vector [rad]."""
        return self._tcp

    @tcp.setter
    def tcp(self, pose: Array) -> None:
        self._tcp, self.X_flange_tcp = pose, poses.matrix(pose)

    def set_payload(self, mass: float, cog: poses.Vector) -> None:
        """Set the payload to compensate.

        Args:
            mass: Mass [kg].
            cog: Centre of gravity, flange frame, (3,) [m].
        """
        self.payload, self.payload_cog = float(mass), np.array(cog, dtype=np.float64)
        self.plant.set_payload(self.payload, self.payload_cog)

    def zero_wrench(self) -> None:
        """Zero the force sensor at the current wrench, where the controller can."""
        self.force_sensor.zero(forward(self.model, self.plant.q)[:3, :3])

    # -- state

    @property
    def moving(self) -> bool:
        """Whether a motion is in progress or the arm has not come to rest."""
        return self._held or bool(self._running_out) or bool(np.abs(self.qd_target).max() > STANDSTILL)

    def tcp_pose(self, target: bool = False) -> Array:
        """Pose X_base_tcp, 4x4, measured or, with `target`, of the set-point."""
        return forward(self.model, self.q_target if target else self.sensors.q) @ self.X_flange_tcp

    def tcp_speed(self, target: bool = False) -> Array:
        """Velocity of the TCP, (6,) [m/s, rad/s], base axes, measured or, with `target`, of the set-point."""
        q, qd = (self.q_target, self.qd_target) if target else (self.sensors.q, self.sensors.qd)
        return tcp_twist(self.model, q, self.X_flange_tcp, qd)

    def wrench(self) -> Array:
        """Wrench of the environment at the flange's origin, (6,) [N, Nm], base axes, less the script's zero."""
        return self.force_sensor.wrench(forward(self.model, self.plant.q)[:3, :3])

    def tcp_force(self) -> Array:
        """Wrench of the environment at the TCP, as `wrench`."""
        return self._at_tcp(self.wrench())

    def _push(self) -> Array:
        """Wrench at the TCP that moves the arm in freedrive, (6,) [N, Nm], base axes."""
        return self._at_tcp(self.force_sensor.push(forward(self.model, self.plant.q)[:3, :3]))

    def _at_tcp(self, wrench: Array) -> Array:
        arm = forward(self.model, self.plant.q)[:3, :3] @ self.tcp[:3]
        return np.concatenate([wrench[:3], wrench[3:] - np.cross(arm, wrench[:3])])

    def _compliant(self, qd: Array, dt: float) -> Array:
        """Commanded joint velocities (6,) [rad/s], modified by force mode or freedrive."""
        if self.compliance is None:
            return qd
        felt = self._push() if self.freedrive else self.tcp_force()
        return self.compliance.apply(self.model, self.X_flange_tcp, self.q_target, qd, felt, dt)

    def goal(self) -> Array:
        """Joint positions at the end of the current move, (6,) [rad]; without a move, the set-point."""
        return self._motion.q_end if isinstance(self._motion, Move) else self.q_target

    def joint_torques(self) -> Array:
        """Joint torques that balance the measured wrench, (6,) [Nm]."""
        links = chain(self.model, self.plant.q)
        return -links.jacobian(links.X_base_flange[:3, 3]).T @ self.wrench()

    @property
    def uncommanded(self) -> bool:
        """Whether a script function has let go of the arm during its motion, and no other one has taken it."""
        return self._let_go and not self.paused

    # -- motion

    @contextmanager
    def moving_by(self, motion: Motion) -> Iterator[None]:
        """Start a motion for which a script function waits within the context, and end it.

        If unfinished, it comes to rest, unless another one starts in the tick.

        Raises:
            MotionError: A function of another thread waits for a motion.
        """
        if self._held:
            raise MotionError("another thread is already controlling the robot")
        if isinstance(motion, Move) and self._running_out:
            motion.start(self._running_out[-1].q_end)
        if self._motion is not None:
            motion.follow(self._motion)
        self._motion, self._held, self._let_go = motion, True, False
        try:
            yield
        finally:
            self._release(motion)

    def _release(self, motion: Motion) -> None:
        if motion is not self._motion:
            return
        self._held = False
        if isinstance(motion, Move) and motion.blending and not motion.done:
            self._running_out.append(motion)
            self._motion = None
        elif not motion.done:
            self._let_go = True
            if not motion.stays:
                self._motion = Brake(self.stops.program)

    def stop(self, deceleration: float | None = None) -> None:
        """Bring every joint to rest; force mode and freedrive end, and script functions see their motion as finished.

        Args:
            deceleration: Deceleration [rad/s^2]; that of a program's end if None.
        """
        self.compliance, self.freedrive = None, False
        if self._motion is not None:
            self._motion.done = True
        self._running_out.clear()
        self._halt = None
        self._motion = self._stop = Brake(self.stops.program if deceleration is None else deceleration)
        self._held = self._let_go = False

    def halt(self, deceleration: float) -> None:
        """Bring every joint to rest in the middle of a motion, which waits for `resume`; force mode and freedrive end.

        Args:
            deceleration: Deceleration of the fastest joint [rad/s^2].
        """
        self.compliance, self.freedrive = None, False
        self._running_out.clear()
        self._halt = Brake(deceleration)

    def resume(self) -> None:
        """Continue after `paused` and `halt`: the motion goes on to its goal from where the arm stands."""
        self.paused = False
        if self._halt is not None and self._motion is not None:
            self._motion.replan()
        self._halt = None

    def end_program(self) -> None:
        """Clean up after a program: a moving arm decelerates; force mode, freedrive and watchdogs end."""
        self.watchdogs.clear()
        self.force_sensor.external, self.paused = False, False
        if self._halt is not None:
            self.stop(self.stops.protective)
        elif self._motion is None or self._motion is not self._stop:
            self.stop()

    def end_compliance(self) -> None:
        """End force mode or freedrive; without a motion in progress the arm comes to rest."""
        self.compliance, self.freedrive = None, False
        if self._motion is None:
            self._motion = Brake(self.stops.program)

    def step(self, dt: float) -> None:
        """Advance the motion by one tick of dt [s], command the plant and step it."""
        wanted = 0.0 if self.paused else self.speed_fraction * self.speed_scaling
        self._rate += max(-RATE_SLEW * dt, min(RATE_SLEW * dt, wanted - self._rate))
        try:
            qd = self._compliant(self._way(dt) / dt, dt)
        except MotionError as error:
            self.events.append(Event(EventKind.PROTECTIVE_STOP, str(error)))
            self.stop(self.stops.protective)
            qd = self._way(dt) / dt
        motion = self._halt or self._motion
        over = motion is None or motion.done
        final = np.zeros(6) if over and not self._running_out and self.compliance is None else qd
        self.q_target = self.q_target + qd * dt
        self.qd_target, self.qdd_target = final, (final - self.qd_target) / dt
        self.plant.command(self.q_target, self.qd_target)
        self.plant.step(dt)
        self.sensors.step(self.model, self.q_target, self.payload, self.payload_cog, self.gravity, dt)
        self.history.append(self.sensors.q)
        self.force_history.append(self.sensors.wrench[:3])

    def _way(self, dt: float) -> Array:
        if self._halt is not None:
            return self._halt.step(self.q_target, self.qd_target, dt, dt)
        way = np.zeros(6)
        scaled = dt * self._rate
        for move in self._running_out:
            way += move.step(self.q_target, self.qd_target, scaled, dt)
        self._running_out = [move for move in self._running_out if not move.done]
        if self._motion is not None:
            way += self._motion.step(self.q_target, self.qd_target, scaled, dt)
            if self._motion.done and not self._held:
                self._motion = self._stop = None
        return way

    def fed(self, variable: str) -> None:
        """Reset the watchdog of an RTDE input variable that a client has written."""
        self.watchdogs.feed(variable)
