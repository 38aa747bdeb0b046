"""What a job is done on: the simulated station itself, or its arm behind a controller and the real arm's driver."""

from __future__ import annotations

from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from toolee_robot.config import StationConfig
from toolee_robot.hal import Station
from toolee_robot.sim_backend.ground_truth.verdict import Truth
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.tools import Tool


class Backend(Protocol):
    """A station, and what only the simulation behind it knows. Valid inside its context."""

    @property
    def station(self) -> Station: ...

    @property
    def tool(self) -> Tool: ...

    @property
    def judge(self) -> Truth: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


@dataclass(frozen=True)
class StandIn:
    """A controller stand-in to go through. host: a loopback address. real_time_factor: of its time and the job's, 1 is
    real."""

    host: str
    real_time_factor: float


def open_backend(config: StationConfig, seed: int, options: SimOptions, stand_in: StandIn | None) -> Backend:
    """stand_in: None: straight to the simulated station."""
    if stand_in is None:
        return SimStation.build(config, seed, options)
    from toolee_robot.stations.ur_rehearsal import UrStation  # the driver and the stand-in: only where they are wanted

    return UrStation(config, seed, options, stand_in.host, stand_in.real_time_factor)
