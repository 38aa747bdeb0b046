"""The simulated world as the controller's plant, instead of ideal joints."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array, inverse
from toolee_robot.sim_backend.devices.flange_sensor import FlangeSensor
from toolee_robot.sim_backend.devices.reading_errors import TURN
from toolee_robot.sim_backend.physics.bullet import pb
from toolee_robot.sim_backend.world import SimWorld
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
