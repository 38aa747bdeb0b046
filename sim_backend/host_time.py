"""Simulated truth stamped on the host's clock, for a world that a controller's tick loop runs in real time."""

from __future__ import annotations

import time

from toolee_robot.frames import Array
from toolee_robot.sim_backend.nail import Nail
from toolee_robot.sim_backend.world import SimWorld


class HostTimedTruth:
    """A `TruthSource` whose time is the host's `time.monotonic()` at the step, which all of the station's stamps are
    on. A tick's steps are computed in a burst, so within a tick stamps are closer together than the steps they mark.
    """

    def __init__(self, world: SimWorld) -> None:
        self._world = world

    @property
    def client(self) -> int:
        return self._world.client

    @property
    def time(self) -> float:
        return time.monotonic()

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
