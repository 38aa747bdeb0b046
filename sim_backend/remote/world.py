"""A simulated world in a process of its own, with a controller stand-in before its arm."""

from __future__ import annotations

import socket
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self

from toolee_robot.config import StationConfig
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.remote.channel import Channel
from toolee_robot.sim_backend.remote.world_setup import WorldJob
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess


class RemoteWorld:
    """The world of a seed, as `SimStation.build` has it, and the stand-in of `config.arm`'s model on a loopback host.

    Time goes on in it by itself, on `clock`. controller: for faults, and how well it keeps time. Leave
    the context only after every client of the controller: the client library aborts the interpreter when the server
    goes first.
    """

    def __init__(self, config: StationConfig, seed: int, options: SimOptions, host: str, clock: HostClock) -> None:
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
        )
        self._channel = Channel(Connection(ours.detach()))

    def __enter__(self) -> Self:
        """Raises UserError for a host that is not loopback or whose ports are taken, DeviceError if it cannot start."""
        try:
            self.controller.__enter__()
        except BaseException:
            self._theirs.close()
            self._channel.close()
            raise
        self._theirs.close()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._channel.close()
        self.controller.__exit__(kind, error, trace)

    def call(self, name: str, *arguments: Any, lasting: float = 0.0) -> Any:
        """See `Channel.call`; lasting on the clock."""
        return self._channel.call(name, *arguments, lasting=self._clock.to_wall_time(lasting))
