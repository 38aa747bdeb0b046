"""Simulated stations: the arm simulated directly, or driven through a controller stand-in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, Self

from toolee_robot.errors import UserError
from toolee_robot.hal import Station
from toolee_robot.sim_backend.ground_truth.verdict import Truth
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.station import StationConfig
from toolee_robot.tools import Tool


class SimulatedStation(Protocol):
    """A station together with the ground truth of its simulation; valid inside its context."""

    @property
    def station(self) -> Station:
        """The devices of the station."""

    @property
    def tool(self) -> Tool:
        """The tool that is handed over."""

    @property
    def judge(self) -> Truth:
        """Ground truth, for the evaluation after the job."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


@dataclass(frozen=True)
class StandIn:
    """Selects a controller stand-in in front of the simulated arm.

    Attributes:
        host: Loopback address of the stand-in.
        real_time_factor: Rate of the job's time relative to wall-clock time; 1 is real time.
        profile: How the controller follows, measures and stops: `ideal`, or `harsh` as one of the arm's generation.
    """

    host: str
    real_time_factor: float
    profile: ProfileName = "ideal"


@dataclass(frozen=True)
class HandDriver:
    """Selects the hand's own driver in front of the simulated hand, with an emulated hand at the end of its wire.

    Attributes:
        port: Port of the emulated hand; None: one is started, and feels what the simulated hand touches.
    """

    port: str | None = None


def open_station(
    config: StationConfig,
    seed: int = 0,
    options: SimOptions | None = None,
    stand_in: StandIn | None = None,
    hand_driver: HandDriver | None = None,
) -> SimulatedStation:
    """Build the simulated station of a job; enter its context to use the devices.

        with open_station(sim_station(), seed=3) as simulated:
            task = HammeringTask(simulated.station, ...)

    Args:
        config: Configuration of the station.
        seed: Seed of tool, grasp and scene.
        options: Options of the simulation; None for the defaults.
        stand_in: Controller stand-in behind which the arm is driven by the real arm's driver, over ur_rtde; None to
            drive the simulated arm directly.
        hand_driver: Driver of the hand; None for the simulated hand directly.

    Returns:
        The station, not yet entered.

    Raises:
        UserError: The seed or an option is unusable, or both the arm and the hand are to have their drivers.
    """
    options = SimOptions() if options is None else options
    if hand_driver is not None:
        if stand_in is not None:
            raise UserError("the arm's and the hand's drivers cannot be tried together yet", code="user.option")
        from toolee_robot.stations.driven_hand import DrivenHandStation

        return DrivenHandStation(config, seed, options, hand_driver.port)
    if stand_in is None:
        return SimStation.build(config, seed, options)
    from toolee_robot.stations.ur_rehearsal import UrStation  # imported only where driver and stand-in are used

    return UrStation(config, seed, options, stand_in.host, stand_in.real_time_factor, stand_in.profile)
