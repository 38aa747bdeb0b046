"""The station's clock in simulation."""

from __future__ import annotations

from toolee_robot.sim_backend.world import SimWorld


class SimClock:
    """A `hal.Clock`: time goes on only while something moves or sleeps."""

    def __init__(self, world: SimWorld) -> None:
        self._world = world

    def now(self) -> float:
        return self._world.time

    def sleep(self, duration: float) -> None:
        if duration > 0:
            self._world.advance(duration)
