"""Everything behind the ports: the arm, its program, its safety system, and what a client may know of them."""

from __future__ import annotations

import struct
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from toolee_robot.frames import Array, cross
from toolee_robot.sim_backend.ur_controller.robot import poses
from toolee_robot.sim_backend.ur_controller.robot.kinematics import Chain, chain
from toolee_robot.sim_backend.ur_controller.robot.machine import EventKind, Machine
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel
from toolee_robot.sim_backend.ur_controller.robot.plant import Plant
from toolee_robot.sim_backend.ur_controller.robot.registers import Registers
from toolee_robot.sim_backend.ur_controller.robot.safety import RobotMode, Safety, SafetyLimits
from toolee_robot.sim_backend.ur_controller.urscript.program import Program, RuntimeState

MESSAGES = 100  # of the script that are kept


@dataclass
class Identity:
    """What the controller says it is: faults may make it lie. version: major, minor, bugfix, build. a, d (6,) [m],
    theta, alpha (6,) [rad]: DH parameters of the factory calibration."""

    model: str
    version: tuple[int, int, int, int]
    serial: str
    a: tuple[float, ...]
    d: tuple[float, ...]
    alpha: tuple[float, ...]
    theta: tuple[float, ...] = (0.0,) * 6

    @classmethod
    def of(cls, model: ControllerModel) -> Identity:
        """The truth about a controller of this model."""
        return cls(model.name, model.version, "20185500001", model.a, model.d, model.alpha)

    @property
    def checksum(self) -> tuple[int, ...]:
        """(6,) of the calibration, a joint each: equal for equal parameters, as a real controller's."""
        rows = zip(self.theta, self.a, self.d, self.alpha, strict=True)
        return tuple(zlib.crc32(struct.pack(">4d", *row)) for row in rows)


class Robot:
    """One robot. log: gets a line about everything a person would want to see.

    joint_offset (6,): added to the measured joints [rad] (a fault). messages: what the script printed and what went
    wrong, newest last, as (timestamp [s], text); said: how many there have been. popup: the text that is on the screen.
    """

    def __init__(
        self,
        model: ControllerModel,
        plant: Plant,
        limits: SafetyLimits | None = None,
        log: Callable[[str], None] = lambda _line: None,
    ) -> None:
        self.model, self.plant, self.log = model, plant, log
        self.identity = Identity.of(model)
        self.registers = Registers()
        self.machine = Machine(model, plant, self.registers)
        self.program = Program(self.machine, lambda: self.safety.forbidden(), log)
        self.safety = Safety(
            self.machine,
            limits or SafetyLimits(),
            log,
            stop_program=self.program.stop,
            pause_program=self.program.pause,
        )
        self.joint_offset = np.zeros(6)
        self.ticks = 0  # ever: a trace is told by them across a reboot
        self._boot_tick = 0
        self.messages: deque[tuple[float, str]] = deque(maxlen=MESSAGES)
        self.said = 0
        self.popup = ""
        self.reading = Reading(self)

    @property
    def timestamp(self) -> float:
        """The controller's time [s] since it was switched on: ticks done, not the wall's clock."""
        return (self.ticks - self._boot_tick) * self.model.period

    @property
    def status_bits(self) -> int:
        """RTDE's robot_status_bits: 0 power on, 1 program running."""
        return int(self.safety.powered) | (self.program.state is RuntimeState.PLAYING) << 1

    def step(self) -> None:
        """One tick: the script, the motion and the physics, what the script asked for, safety."""
        dt = self.model.period
        self.program.step(dt)
        self.machine.step(dt)
        self.ticks += 1
        self.reading = Reading(self)
        self._handle_events()
        speed = self.reading.tcp_speed
        self.safety.step(dt, self.reading.q, float(np.sqrt(speed[:3] @ speed[:3])))

    def say(self, text: str) -> None:
        """A line for the robot's log, which clients of the primary interface also get."""
        self.said += 1
        self.messages.append((self.timestamp, text))

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
        """Give the arm these DH parameters: it reports them and reckons with them."""
        self.model = self.machine.model = model
        self.identity.a, self.identity.d = model.a, model.d

    def reboot(self) -> None:
        """As after the power button: the program is gone, registers and settings are lost, the arm is off."""
        self.program.stop()
        self.machine.stop(self.model.safety_deceleration)  # the brakes fall in
        self.safety.restart()
        self.safety.robot_mode = RobotMode.POWER_OFF
        fresh = Registers()
        self.registers.__dict__.update(fresh.__dict__)
        self._boot_tick = self.ticks
        self.popup = ""


class Reading:
    """What is measured and derived at the end of one tick; derived values are worked out when first asked for.

    q, qd (6,): measured [rad], [rad/s], with the joint offset of a fault in them.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.q = robot.plant.q + robot.joint_offset
        self.qd = robot.plant.qd

    @cached_property
    def tcp_pose(self) -> list[float]:
        """(6,) of the TCP in the controller's base: position [m], rotation vector [rad]."""
        return poses.vector(self._chain.X_base_flange @ self._X_flange_tcp)

    @cached_property
    def tcp_speed(self) -> Array:
        """(6,): [m/s], [rad/s], base axes."""
        return self._chain.jacobian(self._tip) @ self.qd

    @cached_property
    def target_tcp_pose(self) -> list[float]:
        """As `tcp_pose`, of the set-point."""
        return poses.vector(self._target_chain.X_base_flange @ self._X_flange_tcp)

    @cached_property
    def target_tcp_speed(self) -> Array:
        """As `tcp_speed`, of the set-point."""
        tip = self._target_chain.X_base_flange @ self._X_flange_tcp[:, 3]
        return self._target_chain.jacobian(tip[:3]) @ self._robot.machine.qd_target

    @cached_property
    def tcp_force(self) -> Array:
        """(6,) [N, Nm]: what the environment puts on the TCP, at the TCP, base axes."""
        wrench = self._robot.plant.wrench
        arm = self._tip - self._chain.origins[-1]
        return np.concatenate([wrench[:3], wrench[3:] - cross(arm, wrench[:3])])

    @cached_property
    def raw_wrench(self) -> Array:
        """(6,) [N, Nm]: in the flange's axes, with the payload's weight, as the e-Series sensor gives it."""
        machine, wrench = self._robot.machine, self._robot.plant.wrench
        R = self._chain.X_base_flange[:3, :3]
        weight = R.T @ (-machine.payload * np.asarray(machine.gravity))
        torque = R.T @ wrench[3:] + cross(machine.payload_cog, weight)
        return np.concatenate([R.T @ wrench[:3] + weight, torque])

    @cached_property
    def momentum(self) -> float:
        """[kg m/s] of the payload, the part of the arm's momentum that is known."""
        speed = self.tcp_speed[:3]
        return float(self._robot.machine.payload * np.sqrt(speed @ speed))

    @cached_property
    def elbow(self) -> Array:
        """(3,) [m], controller's base."""
        return self._chain.origins[2]

    @cached_property
    def _chain(self) -> Chain:
        return chain(self._robot.model, self.q)

    @cached_property
    def _target_chain(self) -> Chain:
        return chain(self._robot.model, self._robot.machine.q_target)

    @cached_property
    def _X_flange_tcp(self) -> Array:
        return poses.matrix(self._robot.machine.tcp)

    @cached_property
    def _tip(self) -> Array:
        return (self._chain.X_base_flange @ self._X_flange_tcp[:, 3])[:3]
