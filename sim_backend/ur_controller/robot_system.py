"""The robot behind the ports: arm, program, safety system, and the readings that clients can get."""

from __future__ import annotations

import struct
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from toolee_robot.frames import Array, cross
from toolee_robot.sim_backend.ur_controller.profile import IDEAL, Profile, SafetyLimits
from toolee_robot.sim_backend.ur_controller.robot import poses
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import Measured
from toolee_robot.sim_backend.ur_controller.robot.error_codes import ErrorCode
from toolee_robot.sim_backend.ur_controller.robot.kinematics import Chain, chain
from toolee_robot.sim_backend.ur_controller.robot.machine import Machine
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel, Plant
from toolee_robot.sim_backend.ur_controller.robot.registers import EventKind, Registers
from toolee_robot.sim_backend.ur_controller.robot.safety_system import RobotMode, Safety
from toolee_robot.sim_backend.ur_controller.urscript.program import Program, RuntimeState

MESSAGES = 100  # messages of the script that are kept


@dataclass
class Identity:
    """What the controller reports about itself; faults may change it.

    Attributes:
        model: Name of the model.
        version: Version of the software: major, minor, bugfix, build.
        serial: Serial number.
        a: DH parameters a of the factory calibration, (6,) [m].
        d: DH parameters d of the factory calibration, (6,) [m].
        alpha: DH parameters alpha of the factory calibration, (6,) [rad].
        theta: DH parameters theta of the factory calibration, (6,) [rad].
    """

    model: str
    version: tuple[int, int, int, int]
    serial: str
    a: tuple[float, ...]
    d: tuple[float, ...]
    alpha: tuple[float, ...]
    theta: tuple[float, ...] = (0.0,) * 6

    @classmethod
    def of(cls, model: ControllerModel, profile: Profile = IDEAL) -> Identity:
        """The true identity of a controller.

        Args:
            model: The robot's model.
            profile: The controller's profile.

        Returns:
            The identity.
        """
        version = model.version if profile.version is None else profile.version
        return cls(model.name, version, "20185500001", model.a, model.d, model.alpha)

    @property
    def checksum(self) -> tuple[int, ...]:
        """Checksum of each joint's calibration, six values: equal for equal parameters, as a real controller's."""
        rows = zip(self.theta, self.a, self.d, self.alpha, strict=True)
        return tuple(zlib.crc32(struct.pack(">4d", *row)) for row in rows)


class Robot:
    """One robot.

    Args:
        model: Model of arm and controller.
        plant: What the controller moves.
        limits: Limits of the safety system; the profile's if None.
        log: Called with each line of the log.
        profile: How the controller follows, measures and stops.
        seed: Seed of the noise of the sensors.

    Attributes:
        model: Model of arm and controller, with the arm's DH parameters.
        plant: What the controller moves.
        log: Called with each line of the log.
        identity: What the controller reports about itself.
        registers: General purpose registers.
        machine: Set-point, settings, inputs and outputs.
        program: The running script.
        safety: Safety system and power.
        joint_offset: Offset added to the measured joint positions, (6,) [rad]; a fault.
        ticks: Ticks since the process started; continues across a reboot.
        messages: Output of scripts and errors that stopped the arm, as (timestamp [s], text or error), oldest first.
        said: Number of messages so far.
        popup: Text of the popup on the screen.
        reading: What is measured in the latest tick.
    """

    def __init__(
        self,
        model: ControllerModel,
        plant: Plant,
        limits: SafetyLimits | None = None,
        log: Callable[[str], None] = lambda _line: None,
        profile: Profile = IDEAL,
        seed: int = 0,
    ) -> None:
        self.model, self.plant, self.log = model, plant, log
        self.identity = Identity.of(model, profile)
        self.registers = Registers()
        self.machine = Machine(model, plant, self.registers, profile, seed)
        self.program = Program(self.machine, lambda: self.safety.forbidden(), log)
        self.safety = Safety(
            self.machine,
            limits or profile.limits,
            log,
            report=self.say,
            stop_program=self.program.stop,
            pause_program=self.program.pause,
            resume_program=self.program.resume,
        )
        self.joint_offset = np.zeros(6)
        self.ticks = 0
        self._boot_tick = 0
        self.messages: deque[tuple[float, str | ErrorCode]] = deque(maxlen=MESSAGES)
        self.said = 0
        self.popup = ""
        self.reading = Reading(self)

    @property
    def timestamp(self) -> float:
        """The controller's time since it was switched on [s], by its ticks."""
        return (self.ticks - self._boot_tick) * self.model.period

    @property
    def status_bits(self) -> int:
        """RTDE's robot_status_bits: 0 power on, 1 program running."""
        return int(self.safety.powered) | (self.program.state is RuntimeState.PLAYING) << 1

    def step(self) -> None:
        """Execute one tick: script, motion and physics, the script's requests, safety."""
        dt = self.model.period
        self.program.step(dt)
        self.machine.step(dt)
        self.ticks += 1
        self.reading = Reading(self)
        self._handle_events()
        self.safety.step(dt, self.reading.measured)

    def say(self, message: str | ErrorCode) -> None:
        """Add a message to the robot's log, which clients of the primary interface receive."""
        self.said += 1
        self.messages.append((self.timestamp, message))

    def _handle_events(self) -> None:
        events = self.machine.events
        while events:
            event = events.popleft()
            if event.kind is EventKind.TEXT:
                self.say(event.text)
            elif event.kind is EventKind.POPUP:
                self.popup = event.text
                self.log(f"popup: {event.text}")
            elif event.kind is EventKind.PROTECTIVE_STOP:
                self.safety.protective_stop(event.text or "by the program")
            elif event.kind is EventKind.PAUSE:
                self.program.pause()
            else:
                self.program.stop()

    def calibrate(self, model: ControllerModel) -> None:
        """Set the arm's DH parameters, which it reports and computes with."""
        self.model = self.machine.model = model
        self.identity.a, self.identity.d = model.a, model.d

    def reboot(self) -> None:
        """Restart as with the power button: the program ends, registers and settings are lost, the arm is off."""
        self.program.stop()
        self.machine.stop(self.machine.stops.emergency)  # the brakes engage
        self.safety.restart()
        self.safety.robot_mode = RobotMode.POWER_OFF
        fresh = Registers()
        self.registers.__dict__.update(fresh.__dict__)
        self._boot_tick = self.ticks
        self.popup = ""


class Reading:
    """Measured and derived values at the end of one tick; derived values are computed on first use.

    Args:
        robot: The robot.

    Attributes:
        q: Measured joint positions, (6,) [rad], including the joint offset of a fault.
        qd: Measured joint velocities, (6,) [rad/s].
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.q = robot.machine.sensors.q + robot.joint_offset
        self.qd = robot.machine.sensors.qd

    @property
    def measured(self) -> Measured:
        """What the safety system compares with its limits."""
        wrench = self._at_tcp(self._robot.machine.sensors.wrench)
        return Measured(self.q, self.qd, self.tcp_speed, self._jacobian, wrench)

    @cached_property
    def tcp_pose(self) -> list[float]:
        """Pose of the TCP in the controller's base, (6,): position [m], rotation vector [rad]."""
        return poses.vector(self._chain.X_base_flange @ self._X_flange_tcp)

    @cached_property
    def tcp_speed(self) -> Array:
        """Velocity of the TCP, (6,) [m/s, rad/s], base axes."""
        return self._jacobian @ self.qd

    @cached_property
    def target_tcp_pose(self) -> list[float]:
        """Pose of the TCP at the set-point, as `tcp_pose`."""
        return poses.vector(self._target_chain.X_base_flange @ self._X_flange_tcp)

    @cached_property
    def target_tcp_speed(self) -> Array:
        """Velocity of the TCP at the set-point, as `tcp_speed`."""
        tip = self._target_chain.X_base_flange @ self._X_flange_tcp[:, 3]
        return self._target_chain.jacobian(tip[:3]) @ self._robot.machine.qd_target

    @cached_property
    def tcp_force(self) -> Array:
        """Wrench of the environment at the TCP, (6,) [N, Nm], base axes."""
        wrench = self._robot.machine.force_sensor.wrench(self._chain.X_base_flange[:3, :3])
        return self._at_tcp(wrench)

    @cached_property
    def raw_wrench(self) -> Array:
        """Wrench in the flange's axes, (6,) [N, Nm], including the payload's weight, as the e-Series sensor reports."""
        machine, wrench = self._robot.machine, self._robot.machine.sensors.wrench
        R = self._chain.X_base_flange[:3, :3]
        weight = R.T @ (-machine.payload * np.asarray(machine.gravity))
        torque = R.T @ wrench[3:] + cross(machine.payload_cog, weight)
        return np.concatenate([R.T @ wrench[:3] + weight, torque])

    @cached_property
    def tool_acceleration(self) -> Array:
        """Reading of the tool's accelerometer, (3,) [m/s^2], axes of the flange: an axis that points up reads positive.

        Of an arm at rest: the tool's own acceleration is left out. Axes and sign: URScript manual,
        get_tool_accelerometer_reading.
        """
        return self._chain.X_base_flange[:3, :3].T @ self._robot.machine.felt_gravity

    @cached_property
    def momentum(self) -> float:
        """Momentum of arm and payload [kg m/s]; of the payload alone where the profile needs no dynamics."""
        machine = self._robot.machine
        dynamics = machine.sensors.dynamics
        momentum = machine.payload * self.tcp_speed[:3] if dynamics is None else dynamics.momentum
        return float(np.sqrt(momentum @ momentum))

    @cached_property
    def target_moment(self) -> Array:
        """Joint torques of the set-point's motion, (6,) [Nm]; zero where the profile needs no dynamics."""
        dynamics = self._robot.machine.sensors.dynamics
        return np.zeros(6) if dynamics is None else dynamics.torques

    @cached_property
    def elbow(self) -> Array:
        """Position of the elbow in the controller's base, (3,) [m]."""
        return self._chain.origins[2]

    def _at_tcp(self, wrench: Array) -> Array:
        """The wrench at the TCP, (6,), of one at the flange's origin."""
        arm = self._tip - self._chain.origins[-1]
        return np.concatenate([wrench[:3], wrench[3:] - cross(arm, wrench[:3])])

    @cached_property
    def _chain(self) -> Chain:
        return chain(self._robot.model, self.q)

    @cached_property
    def _jacobian(self) -> Array:
        return self._chain.jacobian(self._tip)

    @cached_property
    def _target_chain(self) -> Chain:
        dynamics = self._robot.machine.sensors.dynamics
        return chain(self._robot.model, self._robot.machine.q_target) if dynamics is None else dynamics.links

    @cached_property
    def _X_flange_tcp(self) -> Array:
        return poses.matrix(self._robot.machine.tcp)

    @cached_property
    def _tip(self) -> Array:
        return (self._chain.X_base_flange @ self._X_flange_tcp[:, 3])[:3]
