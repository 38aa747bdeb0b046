"""Setup of a controller stand-in's process whose plant is the simulated world."""

from __future__ import annotations

from dataclasses import dataclass, field
from multiprocessing.connection import Connection

from toolee_robot.robots import load_robot
from toolee_robot.robots.dh import DhParameters
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.remote.world_plant import WorldPlant
from toolee_robot.sim_backend.remote.world_service import WorldService
from toolee_robot.sim_backend.ur_controller.controller import Controller
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel
from toolee_robot.station import StationConfig

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
