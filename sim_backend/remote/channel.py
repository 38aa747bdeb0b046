"""Calls to a simulated world in another process: any number at a time, from any thread."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from contextlib import suppress
from itertools import count
from multiprocessing.connection import Connection
from typing import Any

from toolee_robot.errors import DeviceError

PATIENCE = 5.0
"""[s] beyond a call's own time within which the other side must answer."""


class Channel:
    """The task's end of the pipe to a `WorldService`."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._numbers = count()
        self._pending: dict[int, Future[Any]] = {}
        self._lock = threading.Lock()
        self._closed = False
        self._reader = threading.Thread(target=self._read, name="simulated world", daemon=True)
        self._reader.start()

    def call(self, name: str, *arguments: Any, lasting: float = 0.0) -> Any:
        """The answer to a request. lasting: how long what is asked for may take at most [s of the wall].

        Raises what the other side raised; DeviceError when it has ended or does not answer.
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
                raise DeviceError("the simulated world has ended: start the job again")
        try:
            return answer.result(timeout=lasting + PATIENCE)
        except TimeoutError as error:
            raise DeviceError(f"the simulated world did not answer {name!r} in {lasting + PATIENCE:g} s") from error
        finally:
            self._pending.pop(number, None)

    def close(self) -> None:
        """Say goodbye: the other side ends and hangs up."""
        with self._lock:
            if not self._closed:
                with suppress(OSError):
                    self._connection.send(None)
            self._closed = True
        self._reader.join(PATIENCE)
        self._connection.close()

    def _read(self) -> None:
        while True:
            try:
                number, done, value = self._connection.recv()
            except (EOFError, OSError):
                break
            answer = self._pending.pop(number, None)
            if answer is None:  # nobody waits for it any more
                continue
            if done:
                answer.set_result(value)
            else:
                answer.set_exception(value)
        with self._lock:
            self._closed = True
            left = list(self._pending.values())
        for answer in left:
            answer.set_exception(DeviceError("the simulated world has ended: start the job again"))
