"""A simulated world in a process of its own, whose arm is driven by a controller stand-in."""

from __future__ import annotations

import socket
from multiprocessing.connection import Connection
from typing import Any, Self

from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.remote.channel import Channel
from toolee_robot.sim_backend.remote.world_plant import WorldJob
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.station import StationConfig, check_upright


class RemoteWorld:
    """The world of `SimStation.build` in another process, with a stand-in of the arm's controller on a loopback host.

    Its time advances by itself, on `clock`. Leave the context only after all clients of the controller have closed:
    ur_rtde aborts the interpreter when the server goes first.

    Args:
        config: The station.
        seed: Seed of the run.
        options: Options of the run.
        host: Loopback address of the controller.
        clock: Clock of the world.
        profile: How the controller follows, measures and stops; its noise has the run's seed.

    Raises:
        ConfigError: The arm's base is tilted (`config.mounting_tilted`).

    Attributes:
        controller: The controller's process, for faults and timing statistics.
    """

    def __init__(
        self,
        config: StationConfig,
        seed: int,
        options: SimOptions,
        host: str,
        clock: HostClock,
        profile: ProfileName = "ideal",
    ) -> None:
        check_upright(config.arm, "the simulated world")
        self._clock = clock
        ours, theirs = socket.socketpair()
        self._theirs = theirs
        job = WorldJob(theirs.fileno(), config, seed, options, clock)
        self.controller = ControllerProcess(
            plant=job.plant,
            setup=job.setup,
            inherit=(job.fd,),
            model=str(config.arm.model),
            host=host,
            realtime=True,
            real_time_factor=clock.real_time_factor,
            profile=profile,
            seed=seed,
        )
        self._channel = Channel(Connection(ours.detach()))

    def __enter__(self) -> Self:
        """Start the process.

        Raises:
            UserError: The host is no loopback address, or a port is taken.
            DeviceError: The process cannot start.
        """
        try:
            self.controller.__enter__()
        except BaseException:
            self._theirs.close()
            self._channel.close()
            raise
        self._theirs.close()
        return self

    def __exit__(self, *error: Any) -> None:
        self._channel.close()
        self.controller.__exit__(*error)

    def call(self, name: str, *arguments: Any, lasting: float = 0.0) -> Any:
        """Send a request and wait for its answer.

        Args:
            name: Name of the request.
            *arguments: Its arguments; they must be picklable.
            lasting: Longest duration of the requested action on the world's clock [s].

        Returns:
            The answer.
        """
        return self._channel.call(name, *arguments, lasting=self._clock.to_wall_time(lasting))
