"""A simulated world in a process of its own, with a controller stand-in before its arm: started, watched and ended."""

from __future__ import annotations

import multiprocessing
from types import TracebackType
from typing import Any, Self

from toolee_robot.config import StationConfig
from toolee_robot.errors import DeviceError
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.remote_channel import Channel
from toolee_robot.sim_backend.ur_controller.controller import ControllerOptions
from toolee_robot.sim_backend.ur_controller.world_process import run_world

START_TIME = 60.0  # [s] for the process to load, to build the world and to open its ports
END_TIME = 5.0  # [s] for it to close them


class RemoteWorld:
    """The world of a seed, as `SimStation.build` has it, and the stand-in of `config.arm`'s model on a loopback host.

    Time there goes on by itself, as fast as the wall's. Leave the context only after every client of the controller
    has gone: the client library aborts the interpreter when the server goes first.
    """

    def __init__(self, config: StationConfig, seed: int, options: SimOptions, host: str) -> None:
        """Raises UserError for a host that is not loopback or whose ports are taken, DeviceError if it cannot start."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        controller = ControllerOptions(model=config.arm.model, host=host)
        self._process = context.Process(
            target=run_world, args=(theirs, config, seed, options, controller), name="simulated world", daemon=True
        )
        self._process.start()
        theirs.close()
        try:
            ready, error = ours.recv() if ours.poll(START_TIME) else (False, DeviceError("it takes too long to start"))
        except EOFError:
            ready, error = False, DeviceError("the simulated world's process ended while it started; see its message")
        except BaseException:
            self._end()
            raise
        if not ready:
            self._end()
            raise error
        self._channel = Channel(ours)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def call(self, name: str, *arguments: Any, lasting: float = 0.0) -> Any:
        """See `Channel.call`."""
        return self._channel.call(name, *arguments, lasting=lasting)

    def close(self) -> None:
        """End controller and world."""
        self._channel.close()
        self._process.join(END_TIME)
        self._end()

    def _end(self) -> None:
        if self._process.is_alive():
            self._process.terminate()
        self._process.join(END_TIME)
