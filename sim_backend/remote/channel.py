"""Remote procedure calls to a simulated world in another process; concurrent calls from any thread."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from contextlib import suppress
from itertools import count
from multiprocessing.connection import Connection
from typing import Any

from toolee_robot.errors import DeviceError

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
