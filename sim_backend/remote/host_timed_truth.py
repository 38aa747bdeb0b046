"""Ground truth stamped on the controller's clock, for a world that its tick loop drives."""

from __future__ import annotations

from collections.abc import Mapping

from toolee_robot.frames import Array
from toolee_robot.hal import Clock
from toolee_robot.sim_backend.physics.nail import Nail
from toolee_robot.sim_backend.world import SimWorld


class HostTimedTruth:
    """A `TruthSource` whose time is the controller's clock at the step, on which all of the station's stamps are.

    The steps of a tick are computed in a burst, so their stamps are closer together than the steps in simulated time.

    Args:
        world: The simulated world.
        clock: The controller's clock.
    """

    def __init__(self, world: SimWorld, clock: Clock) -> None:
        self._world, self._clock = world, clock

    @property
    def client(self) -> int:
        """Id of pybullet's physics client."""
        return self._world.client

    @property
    def time(self) -> float:
        """Time on the controller's clock [s]."""
        return self._clock.now()

    @property
    def nail(self) -> Nail:
        """The nail that the tool is nearest to."""
        return self._world.nail

    @property
    def nails(self) -> Mapping[str, Nail]:
        """The nails by name."""
        return self._world.nails

    @property
    def tool_body(self) -> int:
        """Id of the tool's body in pybullet."""
        return self._world.tool_body

    @property
    def robot_body(self) -> int:
        """Id of the robot's body in pybullet."""
        return self._world.robot_body

    def X_base_hand(self) -> Array:
        """Pose of the palm, 4x4."""
        return self._world.X_base_hand()

    def X_base_ee(self) -> Array:
        """Pose of the tool's end effector, 4x4."""
        return self._world.X_base_ee()
