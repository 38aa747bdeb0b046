"""The simulated station of a job."""

from __future__ import annotations

from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.station import StationConfig


def open_station(config: StationConfig, seed: int = 0, options: SimOptions | None = None) -> SimStation:
    """Build the simulated station of a job; enter its context to use the devices.

        with open_station(sim_station(), seed=3) as simulated:
            task = HammeringTask(simulated.station, ...)

    Args:
        config: Configuration of the station.
        seed: Seed of tool, grasp and scene.
        options: Options of the simulation; None for the defaults.

    Returns:
        The station, not yet entered.

    Raises:
        UserError: The seed or an option is unusable.
    """
    return SimStation.build(config, seed, SimOptions() if options is None else options)
