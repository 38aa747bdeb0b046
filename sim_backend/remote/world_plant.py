"""The simulated world as the plant of a controller stand-in's process, and that process's setup."""

from __future__ import annotations

from dataclasses import dataclass, field
from multiprocessing.connection import Connection

import numpy as np

from toolee_robot.frames import Array, inverse
from toolee_robot.robots import load_robot
from toolee_robot.robots.dh import DhParameters
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.devices.flange_sensor import TURN, FlangeSensor
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.physics.bullet import pb
from toolee_robot.sim_backend.remote.world_service import WorldService
from toolee_robot.sim_backend.ur_controller.controller import Controller
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.station import StationConfig
from toolee_robot.types import Payload


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
