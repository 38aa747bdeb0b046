"""The controller's errors, read from the primary interface in a thread of the task's process.

The controller sends an error once, when it occurs, to who is connected then; hence a connection for as long as the
driver is open. Nothing is sent on it, and the servo process has no part in it.
"""

from __future__ import annotations

import threading
import time
from typing import Final

from toolee_robot.devices.ur.protocols.primary import PRIMARY_PORT, ControllerError, errors_in
from toolee_robot.devices.ur.protocols.tcp import connect, receive
from toolee_robot.errors import DeviceError
from toolee_robot.runtime.clock import HostClock

TIMEOUT: Final = 1.0
"""[s] of a connection, and of silence on it: the controller sends its state ten times a second."""
RETRY: Final = 1.0  # [s] between two connections
WAIT: Final = 0.3
"""[s] Longest wait for the error that explains a stop: the controller's period here is 0.1 s."""


class ErrorLog:
    """The errors since the last `forget`. Where the port is closed there are none, and `why_empty` says so.

    Args:
        host: Address of the controller.
        clock: The station's clock.
    """

    def __init__(self, host: str, clock: HostClock) -> None:
        self._host, self._clock = host, clock
        self._changed = threading.Condition()
        self._errors: list[ControllerError] = []
        self._failure = f"port {PRIMARY_PORT} has not answered yet"
        self._closed = threading.Event()
        threading.Thread(target=self._run, name="arm error log", daemon=True).start()

    def close(self) -> None:
        """End the connection; the thread ends within TIMEOUT."""
        self._closed.set()

    def forget(self) -> None:
        """Forget all errors: those to come belong to what begins now."""
        with self._changed:
            self._errors.clear()

    def reason(self) -> ControllerError | None:
        """The error that explains a stop: of the most severe ones the first, since what follows are consequences.

        Waits up to WAIT on the station's clock for one to arrive, but not where there is no connection.

        Returns:
            The error; None where the controller has sent none.
        """
        deadline = time.monotonic() + self._clock.to_wall_time(WAIT)
        with self._changed:
            while not self._errors and not self._failure and (left := deadline - time.monotonic()) > 0.0:
                self._changed.wait(left)
            return self._most_severe()

    def told(self) -> ControllerError | None:
        """What `reason` returns, without a wait."""
        with self._changed:
            return self._most_severe()

    @property
    def why_empty(self) -> str:
        """Why there may be no errors, a clause for a message."""
        return self._failure or f"it sent none on port {PRIMARY_PORT}"

    def _most_severe(self) -> ControllerError | None:
        return max(self._errors, key=lambda error: error.level, default=None)

    def _run(self) -> None:
        timeout, retry = (self._clock.to_wall_time(seconds) for seconds in (TIMEOUT, RETRY))
        while not self._closed.is_set():
            try:
                self._read(timeout)
            except DeviceError as error:
                self._fails(f"no messages come from its port {PRIMARY_PORT} ({error})")
            self._closed.wait(retry)

    def _read(self, timeout: float) -> None:
        with connect(self._host, PRIMARY_PORT, time.monotonic() + timeout) as sock:
            buffer = bytearray()
            while not self._closed.is_set():
                buffer += receive(sock, time.monotonic() + timeout)
                if errors := [error for error in errors_in(buffer) if error.serious]:
                    with self._changed:
                        self._errors += errors
                        self._changed.notify_all()
                if self._failure:
                    self._fails("")

    def _fails(self, why: str) -> None:
        with self._changed:
            self._failure = why
            self._changed.notify_all()
