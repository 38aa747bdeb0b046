"""The simulated world as the controller's plant: arm, hand, tool, nail and person instead of bare joints."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array, inverse
from toolee_robot.sim_backend.devices.flange_sensor import FlangeSensor
from toolee_robot.sim_backend.physics.bullet import pb
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.types import Payload

TURN = np.array([-1.0, -1.0, 1.0, -1.0, -1.0, 1.0])
"""A wrench in `base_link`'s axes to the controller's base and back: half a turn about z."""


class WorldPlant:
    """A `Plant` on a `SimWorld`: the controller's ticks let the world's time go on, and nothing else does.

    The wrench is what the force sensor at the flange feels, the mean over a tick, less the payload that the
    controller has been told: without one, the hand's own weight. external_force acts on the hand's mount for real: it
    is felt, and it pushes the arm.
    """

    def __init__(self, world: SimWorld, period: float) -> None:
        """period: of the controller's tick [s], and of every `step`: the sensor's means are those of the ticks."""
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
        return self._q

    @property
    def qd(self) -> Array:
        return self._qd

    @property
    def wrench(self) -> Array:
        return TURN * self._sensor.wrench

    def set_payload(self, mass: float, cog: Array) -> None:
        self._sensor.payload = Payload(mass, np.array(cog, dtype=np.float64))
        self._sensor.begin()

    def command(self, q: Array, qd: Array) -> None:  # noqa: ARG002  (the path between set-points is straight)
        self._target = np.array(q, dtype=np.float64)

    def step(self, dt: float) -> None:
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
