"""A simulated world in a process of its own, whose arm is driven by a controller stand-in.

Its process answers remote procedure calls, concurrent ones from any thread.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import suppress
from itertools import count
from multiprocessing.connection import Connection
from typing import Any, Protocol, Self

from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.truth import StrikeTruth, Verdict
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.sim_backend.world_plant import WorldJob
from toolee_robot.station import StationConfig, check_upright
from toolee_robot.types import InHandEstimate

ANSWER_MARGIN = 5.0
"""[s] on the wall clock beyond a call's own duration within which the world must answer."""


class Channel:
    """The task's end of the pipe to a `WorldService`.

    Args:
        connection: The task's end of the pipe, which the channel closes.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._numbers = count()
        self._pending: dict[int, Future[Any]] = {}
        self._lock = threading.Lock()
        self._closed = False
        self._reader = threading.Thread(target=self._read, name="simulated world", daemon=True)
        self._reader.start()

    def call(self, name: str, *arguments: Any, lasting: float = 0.0) -> Any:
        """Send a request and wait for its answer.

        Args:
            name: Name of the request, such as "hand.close".
            arguments: Its arguments.
            lasting: Longest duration of the requested action [s] on the wall clock.

        Returns:
            The answer.

        Raises:
            DeviceError: The world has ended or does not answer.
            Exception: The error that the world raised.
        """
        answer: Future[Any] = Future()
        with self._lock:
            number = next(self._numbers)
            if not self._closed:
                self._pending[number] = answer
                try:
                    self._connection.send((number, name, arguments))
                except OSError:
                    self._closed = True
            if self._closed:
                self._pending.pop(number, None)
                raise _ended()
        try:
            return answer.result(timeout=lasting + ANSWER_MARGIN)
        except TimeoutError as error:
            message = f"the simulated world did not answer {name!r} in {lasting + ANSWER_MARGIN:g} s"
            raise DeviceError(message, code="device.timeout") from error
        finally:
            self._pending.pop(number, None)

    def close(self) -> None:
        """End the world and close the pipe."""
        with self._lock:
            if not self._closed:
                with suppress(OSError):
                    self._connection.send(None)
            self._closed = True
        self._reader.join(ANSWER_MARGIN)
        self._connection.close()

    def _read(self) -> None:
        while True:
            try:
                number, done, value = self._connection.recv()
            except (EOFError, OSError):
                break
            answer = self._pending.pop(number, None)
            if answer is None:  # its caller has timed out
                continue
            if done:
                answer.set_result(value)
            else:
                answer.set_exception(value)
        with self._lock:
            self._closed = True
            left = list(self._pending.values())
        for answer in left:
            answer.set_exception(_ended())


def _ended() -> DeviceError:
    return DeviceError("the simulated world has ended: start the job again", code="device.world_ended")


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


class Caller(Protocol):
    """Sends requests to the world; implemented by `RemoteWorld`."""

    def call(self, name: str, *arguments: Any, lasting: float = 0.0) -> Any:
        """Send a request and wait for its answer.

        Args:
            name: Name of the request.
            *arguments: Its arguments; they must be picklable.
            lasting: Longest duration of the requested action [s].

        Returns:
            The answer.
        """


class RemoteJudge:
    """A `Truth`: the judge in the world's process. Its stamps are on the world's clock.

    Args:
        world: Sends the requests.
    """

    def __init__(self, world: Caller) -> None:
        self._world = world

    @property
    def strikes(self) -> tuple[StrikeTruth, ...]:
        strikes: tuple[StrikeTruth, ...] = self._world.call("judge.strikes")
        return strikes

    def X_hand_ee(self, stamp: float) -> Array:
        X: Array = self._world.call("judge.X_hand_ee", stamp)
        return X

    def verdict(self, estimates: Sequence[tuple[float, InHandEstimate]] = ()) -> Verdict:
        verdict: Verdict = self._world.call("judge.verdict", list(estimates))
        return verdict
