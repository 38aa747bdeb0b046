"""The simulated world as the plant of a controller stand-in's process, and that process's setup.

A service in the tick loop offers the world's devices and its judge to another process.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from greenlet import getcurrent, greenlet

from toolee_robot.errors import DeviceError, TooleeError
from toolee_robot.frames import Array, inverse
from toolee_robot.hal import Clock
from toolee_robot.robots import load_robot
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.devices.flange_sensor import TURN, FlangeSensor
from toolee_robot.sim_backend.devices.hand import CoupledFingers
from toolee_robot.sim_backend.devices.operator import SimPerson
from toolee_robot.sim_backend.judge import Judge
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.physics.bodies import pb
from toolee_robot.sim_backend.station import build_world, draw_handover, simulated_hand
from toolee_robot.sim_backend.ur_controller.controller import Controller
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel
from toolee_robot.sim_backend.visuals import scene_state
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.station import StationConfig
from toolee_robot.types import Payload


class Commands:
    """The running commands of a world, at most one per device. All calls must come from the world's thread.

    Args:
        world: The simulated world.
    """

    def __init__(self, world: SimWorld) -> None:
        self._world = world
        self._hub = getcurrent()
        self._running: dict[str, greenlet] = {}
        self._due: dict[greenlet, float] = {}
        world.wait = self._wait
        world.after_step.append(self._wake)

    def start(self, device: str, call: Callable[[], None]) -> None:
        """Start a command; returns when it has finished or first waits.

        Args:
            device: Name of the device.
            call: The command, which must not raise.

        Raises:
            DeviceError: The device still executes another command.
        """
        if device in self._running:
            message = f"the {device} still executes another command: wait for it, or stop the {device}"
            raise DeviceError(message, code="device.busy")

        def run() -> None:
            try:
                call()
            finally:
                self._running.pop(device, None)

        command = self._running[device] = greenlet(run, self._hub)
        command.switch()

    def _wait(self, duration: float) -> None:
        command = getcurrent()
        if command not in self._running.values():
            raise RuntimeError("the controller's loop advances the time: nothing else may wait in it")
        self._due[command] = self._world.time + duration
        self._hub.switch()

    def _wake(self) -> None:
        if not self._due:
            return
        now = self._world.time + 1e-9
        for command in [c for c, due in self._due.items() if due <= now]:
            del self._due[command]
            command.switch()


Handler = Callable[..., Any]


class WorldService:
    """A `Service` with hand, person, judge and scene of a world that a `WorldPlant` moves.

    Args:
        connection: This process's end of the pipe.
        config: The station.
        seed: Seed of the run.
        options: Options of the run.
        clock: The controller's clock, on which all stamps are.

    Attributes:
        world: The simulated world.
        ended: Callback for the end of the other process, after which the controller is not needed.
    """

    def __init__(
        self, connection: Connection, config: StationConfig, seed: int, options: SimOptions, clock: Clock
    ) -> None:
        tool, offset = draw_handover(seed, options)
        self.world = world = build_world(config, tool, options)
        self.ended: Callable[[], None] = lambda: None
        self._connection, self._clock = connection, clock
        self._commands = Commands(world)
        hand = simulated_hand(world, options)
        fingers = CoupledFingers(world, options.friction)
        person = SimPerson(world, offset, options.hands_over)
        judge = Judge(world, clock)
        world.after_step.append(judge.after_step)
        # Commands that take time, with their device: each device executes one at a time.
        self._lasting: dict[str, tuple[str, Handler]] = {
            "hand.open": ("hand", hand.open),
            "hand.close": ("hand", hand.close),
            "fingers.grip": ("hand", fingers.grip),
            "person.request_handover": ("person", person.request_handover),
            "person.release": ("person", person.release),
            "person.take_tool": ("person", person.take_tool),
        }
        self._immediate: dict[str, Handler] = {
            "fingers.follow": fingers.follow,
            "fingers.let_go": fingers.let_go,
            "scene": lambda: scene_state(world, person),
            "judge.strikes": lambda: judge.strikes,
            "judge.X_hand_ee": judge.X_hand_ee,
            "judge.verdict": judge.verdict,
        }

    def filenos(self) -> Sequence[int]:
        """The pipe's descriptor."""
        return () if self._connection.closed else (self._connection.fileno(),)

    def on_readable(self, fd: int) -> None:  # noqa: ARG002  (there is one)
        """Handle a request."""
        request = None
        with suppress(EOFError, OSError):
            request = self._connection.recv()
        if request is None:
            self._connection.close()
            self.ended()
            return
        number, name, arguments = request
        if name in self._lasting:
            device, handler = self._lasting[name]
            try:
                self._commands.start(device, lambda: self._answer(number, handler, arguments))
            except DeviceError as error:
                self._send(number, False, error)
        elif name in self._immediate:
            self._answer(number, self._immediate[name], arguments)
        else:
            message = f"the simulated world knows no {name!r}"
            self._send(number, False, DeviceError(message, code="device.unknown_request"))

    def on_tick(self, dt: float) -> None:
        """Nothing: the world's steps resume the commands."""

    def close(self) -> None:
        """Close the pipe and the world."""
        self._connection.close()
        self.world.close()

    def _answer(self, number: int, handler: Handler, arguments: tuple[Any, ...]) -> None:
        try:
            value = handler(*arguments)
        except TooleeError as error:
            self._send(number, False, error)
        except Exception as error:  # noqa: BLE001  (passed to the caller; the arm's controller must continue)
            traceback.print_exc(file=sys.stderr)
            message = f"the simulated world failed: {type(error).__name__}: {error}"
            self._send(number, False, DeviceError(message, code="device.world_failed"))
        else:
            self._send(number, True, value)

    def _send(self, number: int, done: bool, value: Any) -> None:
        with suppress(OSError):  # closed: the next read notices
            self._connection.send((number, done, value))


class WorldPlant:
    """A `Plant` on a `SimWorld`, whose time is advanced only by the controller's ticks.

    The wrench is the mean of the flange's force sensor over a tick, compensated for the payload that is set in the
    controller.

    Args:
        world: The simulated world.
        period: Period of the controller's ticks [s], which is the duration of every `step`.

    Attributes:
        external_force: Wrench applied to the hand's mount, (6,) [N, Nm], in the controller's base; it is measured and
            moves the arm.
    """

    def __init__(self, world: SimWorld, period: float) -> None:
        self.external_force = np.zeros(6)
        self._world = world
        self._sensor = FlangeSensor(world, Payload(0.0), period)
        self._held = world.robot.q_arm_target.copy()
        self._target = self._held.copy()
        self._q, self._qd = world.robot.arm_state()
        world.wrench = lambda: self._sensor.wrench.copy()
        world.before_step.append(self._push)

    @property
    def q(self) -> Array:
        """Joint positions, (6,) [rad]."""
        return self._q

    @property
    def qd(self) -> Array:
        """Joint velocities, (6,) [rad/s]."""
        return self._qd

    @property
    def wrench(self) -> Array:
        """Compensated wrench at the flange, (6,) [N, Nm], in the controller's base."""
        return TURN * self._sensor.wrench

    def set_payload(self, mass: float, cog: Array) -> None:
        """See `Plant`."""
        self._sensor.payload = Payload(mass, np.array(cog, dtype=np.float64))
        self._sensor.begin()
        self._world.robot.set_payload(self._sensor.payload)

    def command(self, q: Array, qd: Array) -> None:  # noqa: ARG002  (the path between set-points is straight)
        """See `Plant`; the path between set-points is straight."""
        self._target = np.array(q, dtype=np.float64)

    def step(self, dt: float) -> None:
        """Advance the world by dt [s]."""
        self._world.robot.command_arm(self._held, (self._target - self._held) / dt)
        self._world.run(dt)
        self._held = self._target
        self._q, self._qd = self._world.robot.arm_state()

    def _push(self, _dt: float) -> None:
        if not self.external_force.any():
            return
        robot = self._world.robot
        wrench = TURN * self.external_force
        flange = (robot.link_pose(robot.sensor_link) @ inverse(robot.robot.hand.X_flange_root))[:3, 3]
        body, link, client = robot.body, robot.sensor_link, self._world.client
        pb.applyExternalForce(body, link, wrench[:3].tolist(), flange.tolist(), pb.WORLD_FRAME, physicsClientId=client)
        pb.applyExternalTorque(body, link, wrench[3:].tolist(), pb.WORLD_FRAME, physicsClientId=client)


PUBLISH_AT = 0.5
"""Fraction of a tick after which its data are sent. The command of a driver that answers a third of a tick later still
arrives well before the next tick, and so do the data of a tick whose computation takes three quarters of its time."""


@dataclass
class WorldJob:
    """Provides `plant` and `setup` of a `ControllerProcess`; both run in the child, in this order.

    Attributes:
        fd: The child's end of a socket pair, for the `WorldService`; the controller ends when it is closed.
        config: The station.
        seed: Seed of the run.
        options: Options of the run.
        clock: The controller's clock.
    """

    fd: int
    config: StationConfig
    seed: int
    options: SimOptions
    clock: HostClock
    _service: WorldService | None = field(default=None, init=False)

    def plant(self, model: ControllerModel) -> WorldPlant:
        """Build the world with hand, person and judge.

        Args:
            model: The controller's model.

        Returns:
            The plant.
        """
        self._service = WorldService(Connection(self.fd), self.config, self.seed, self.options, self.clock)
        return WorldPlant(self._service.world, model.period)

    def setup(self, controller: Controller) -> None:
        """Add the world's service to the controller's loop, and set the robot up as at the pendant.

        The payload is the bare hand, the kinematics are the arm's calibration.

        Args:
            controller: The controller, which does not listen yet.
        """
        assert self._service is not None, "`plant` must be called first"
        config, robot = self.config, controller.robot
        model = load_robot(config.arm.model, config.arm.calibration, config.hand)
        hand = model.hand_payload(model.hand_open)
        robot.machine.payload, robot.machine.payload_cog = hand.mass, hand.center_of_mass
        robot.plant.set_payload(hand.mass, hand.center_of_mass)
        dh, identity = DhParameters.of(self.config.arm.model, self.config.arm.calibration), robot.identity
        identity.a, identity.d = dh.a.tolist(), dh.d.tolist()
        identity.alpha, identity.theta = dh.alpha.tolist(), dh.theta.tolist()
        self._service.ended = controller.stop
        controller.add_service(self._service)
        controller.publish_at = PUBLISH_AT
