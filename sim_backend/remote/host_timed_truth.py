"""Simulated truth stamped on the host's clock, for a world that a controller's tick loop runs."""

from __future__ import annotations

from toolee_robot.frames import Array
from toolee_robot.hal import Clock
from toolee_robot.sim_backend.physics.nail import Nail
from toolee_robot.sim_backend.world import SimWorld


class HostTimedTruth:
    """A `TruthSource` whose time is that of `clock`, the controller's, at the step: all of the station's stamps are on
    it. A tick's steps are computed in a burst, so within a tick stamps are closer together than the steps they mark.
    """

    def __init__(self, world: SimWorld, clock: Clock) -> None:
        self._world, self._clock = world, clock

    @property
    def client(self) -> int:
        return self._world.client

    @property
    def time(self) -> float:
        return self._clock.now()

    @property
    def nail(self) -> Nail:
        return self._world.nail

    @property
    def tool_body(self) -> int:
        return self._world.tool_body

    def X_base_hand(self) -> Array:
        return self._world.X_base_hand()

    def X_base_ee(self) -> Array:
        return self._world.X_base_ee()
