"""The station's clock in simulation."""

from __future__ import annotations

from toolee_robot.sim_backend.world import SimWorld


class SimClock:
    """A `hal.Clock` whose time advances only while something moves or sleeps.

    Args:
        world: The simulated world.
    """

    def __init__(self, world: SimWorld) -> None:
        self._world = world

    def now(self) -> float:
        """Simulated time [s]."""
        return self._world.time

    def sleep(self, duration: float) -> None:
        """Advance the simulation by `duration` [s]; does nothing for a duration of 0 or less."""
        if duration > 0:
            self._world.advance(duration)
