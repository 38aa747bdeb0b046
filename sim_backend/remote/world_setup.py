"""What a controller stand-in's process makes of itself to have the simulated world as its plant."""

from __future__ import annotations

from dataclasses import dataclass, field
from multiprocessing.connection import Connection

from toolee_robot.config import StationConfig
from toolee_robot.robots import load_robot
from toolee_robot.robots.dh import DhParameters
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.remote.world_plant import WorldPlant
from toolee_robot.sim_backend.remote.world_service import WorldService
from toolee_robot.sim_backend.ur_controller.controller import Controller
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel

PUBLISH_AT = 0.5
"""A driver that commands a third of a tick after the data has its command here well before the next tick, and the data
of a tick that takes three quarters of its time still come before that."""


@dataclass
class WorldJob:
    """`plant` and `setup` of a `ControllerProcess`; both run in the child, in this order.

    fd: the child's end of a socket pair, for the `WorldService`; the controller ends with it. The rest is what
    `SimStation.build` takes. clock: the controller's.
    """

    fd: int
    config: StationConfig
    seed: int
    options: SimOptions
    clock: HostClock
    _service: WorldService | None = field(default=None, init=False)

    def plant(self, model: ControllerModel) -> WorldPlant:
        """The world, with hand, person and judge; the arm waits where the options have it."""
        self._service = WorldService(Connection(self.fd), self.config, self.seed, self.options, self.clock)
        return WorldPlant(self._service.world, model.period)

    def setup(self, controller: Controller) -> None:
        """Serve hand, person and judge in the controller's loop; set the robot up as a lab does at the pendant: the
        bare hand is its payload. The arm's calibration is the controller's too."""
        assert self._service is not None, "the plant comes first"
        config, robot = self.config, controller.robot
        model = load_robot(config.arm.model, config.arm.calibration, config.hand.model)
        hand = model.hand_payload(model.hand_open)
        robot.machine.payload, robot.machine.payload_cog = hand.mass, hand.center_of_mass
        robot.plant.set_payload(hand.mass, hand.center_of_mass)
        dh, identity = DhParameters.of(self.config.arm.model, self.config.arm.calibration), robot.identity
        identity.a, identity.d = dh.a.tolist(), dh.d.tolist()
        identity.alpha, identity.theta = dh.alpha.tolist(), dh.theta.tolist()
        self._service.ended = controller.stop
        controller.add_service(self._service)
        controller.publish_at = PUBLISH_AT
