"""The simulated station with its arm driven by the real driver through a controller stand-in."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, Self

from toolee_robot.hal import Station
from toolee_robot.runtime.clock import HostClock
from toolee_robot.runtime.cpu_keepalive import CpuKeepalive
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.remote.station import RemoteJudge, remote_station
from toolee_robot.sim_backend.remote.world import RemoteWorld
from toolee_robot.sim_backend.station import draw_handover
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.station import StationConfig
from toolee_robot.stations.ur import ur_driver


class UrStation:
    """The simulated station of a seed, with the arm driven by its real driver over ur_rtde.

    The controller is a stand-in in a process of its own, with the simulated world as its plant.

    Args:
        config: Configuration of the station.
        seed: Seed of tool, grasp and scene, as for `SimStation.build`.
        options: Options of the simulation.
        host: Loopback address of the stand-in.
        real_time_factor: Rate of the station's time relative to wall-clock time; 1 is real time.
        profile: How the controller follows, measures and stops.

    Attributes:
        station: The devices of the station; set inside the context.
        tool: The tool that is handed over.
        judge: Ground truth, for the evaluation after the job.
    """

    station: Station

    def __init__(
        self,
        config: StationConfig,
        seed: int,
        options: SimOptions,
        host: str,
        real_time_factor: float,
        profile: ProfileName = "ideal",
    ) -> None:
        self._config, self._seed, self._host, self._clock = config, seed, host, HostClock(real_time_factor)
        self.tool, _ = draw_handover(seed, options)
        self._world = RemoteWorld(config, seed, options, host, self._clock, profile)
        self.judge = RemoteJudge(self._world)
        self._open = ExitStack()

    def __enter__(self) -> Self:
        """Start the world and the stand-in, and connect the driver.

        Raises:
            UserError: The stand-in cannot listen on the host's address.
            DeviceError: The arm cannot be connected.
        """
        config = self._config
        with ExitStack() as stack:
            stack.enter_context(CpuKeepalive())
            world = stack.enter_context(self._world)
            # Contexts close in reverse order, so that the client closes before its controller.
            arm = stack.enter_context(ur_driver(config, self._host, real_time_factor=self._clock.real_time_factor))
            self.station = remote_station(world, config, self._seed, self.tool, arm, self._clock)
            self._open = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._open.__exit__(*error)
