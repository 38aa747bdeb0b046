"""What a hand's bytes go through, a serial port or a TCP connection, with the errors of a hand's."""

from __future__ import annotations

import socket
import termios
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import serial
from serial.tools.list_ports import comports

from toolee_robot.errors import ConfigError, NoAnswerError, words_of
from toolee_robot.runtime.clock import readable

READ_S, CONNECT_S = 0.01, 1.0
"""Longest wait for the first byte, and for a connection."""
MOST_DROPPED = 64
"""Chunks that are dropped at once."""
_CHUNK = 4096
_BY_ID = Path("/dev/serial/by-id")
"""Where Linux names serial ports by what is plugged in."""


class Port(ABC):
    """What the bytes go through; one thread may use it. It is never opened again by itself.

    Args:
        path: A serial port, or `tcp://HOST:PORT`.

    Attributes:
        path: The same.
    """

    def __init__(self, path: str) -> None:
        self.path = path

    @abstractmethod
    def close(self) -> None:
        """Release it; nothing is said to the hand."""

    @abstractmethod
    def _send(self, data: bytes) -> bool: ...

    @abstractmethod
    def _receive(self, within: float) -> bytes: ...

    def send(self, data: bytes) -> bool:
        """Send bytes; whether they went out in time.

        Raises:
            NoAnswerError: The port is gone.
        """
        with self._watched():
            return self._send(data)

    def receive(self) -> bytes:
        """Return what has come, after READ_S at most; none if nothing came.

        Raises:
            NoAnswerError: The port is gone.
        """
        with self._watched():
            return self._receive(READ_S)

    def drop_received(self) -> None:
        """Forget what has come.

        Raises:
            NoAnswerError: The port is gone.
        """
        with self._watched():
            for _ in range(MOST_DROPPED):
                if not self._receive(0.0):
                    return

    @contextmanager
    def _watched(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError, TypeError, termios.error) as error:  # the last three of a port that was closed
            message = (
                f"the hand's port {self.path} is gone ({words_of(error)}): look at its power and plug the cable in"
            )
            raise NoAnswerError(f"{message}, then start again", code="no_answer.hand_unplugged") from error


class SerialPort(Port):
    """A serial port with 8 data bits, no parity, 1 stop bit.

    Args:
        path: Its path.
        baud_rate: Its rate [bit/s].
        send_s: Longest time for sending.

    Raises:
        NoAnswerError: It cannot be opened.
    """

    def __init__(self, path: str, baud_rate: int, send_s: float) -> None:
        super().__init__(path)
        try:
            self._serial = serial.Serial(path, baud_rate, timeout=READ_S, write_timeout=send_s, exclusive=True)
        except (OSError, ValueError, termios.error) as error:  # pyserial's errors are OSErrors
            raise NoAnswerError(
                f"cannot open the hand's port {path} ({words_of(error)}; this computer has "
                f"{', '.join(serial_ports()) or 'no serial port'}): check hand.port, the cable, and your rights to the "
                "port. Close other programs that use it"
            ) from error

    def close(self) -> None:
        """Release it; nothing is said to the hand."""
        self._serial.close()

    def _send(self, data: bytes) -> bool:
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            return False
        return True

    def _receive(self, within: float) -> bytes:
        waiting = self._serial.in_waiting
        return self._serial.read(max(1, waiting)) if waiting or within else b""


class TcpPort(Port):
    """A TCP connection.

    Args:
        path: `tcp://HOST:PORT`.
        send_s: Longest time for sending.

    Raises:
        NoAnswerError: Nobody can be connected to.
        ConfigError: The path has another form.
    """

    def __init__(self, path: str, send_s: float) -> None:
        super().__init__(path)
        try:
            self._socket = socket.create_connection(tcp_address(path), CONNECT_S)
        except OSError as error:
            message = f"cannot connect to the hand at {path}: {words_of(error)}; check hand.port, its power, the cable"
            message += ", and that this computer has an address in the hand's network"
            raise NoAnswerError(message) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(send_s)

    def close(self) -> None:
        """Release it; nothing is said to the hand."""
        self._socket.close()

    def _send(self, data: bytes) -> bool:
        try:
            self._socket.sendall(data)
        except TimeoutError as error:  # a part of it may be out, which nobody could tell from the next request
            raise ConnectionAbortedError("the hand takes no more bytes") from error
        return True

    def _receive(self, within: float) -> bytes:
        if not readable([self._socket.fileno()], within):
            return b""
        data = self._socket.recv(_CHUNK)
        if not data:
            raise ConnectionResetError("the hand has closed it")
        return data


T = TypeVar("T")


@dataclass
class LineCounts:
    """What happened on the wire so far."""

    requests: int = 0
    """Requests sent, repeated ones included."""
    unanswered: int = 0
    """Requests that nothing usable came back for."""
    corrupt: int = 0
    """Replies that were found damaged."""
    late: int = 0
    """Replies that were older than one that was there already, repeated ones included."""


class PortLine:
    """The hand at the other end of a port; one thread may use it.

    Args:
        port: The port.
        within: Time for a reply [s].

    Attributes:
        counts: What happened on the line so far.
    """

    def __init__(self, port: Port, within: float) -> None:
        self.counts = LineCounts()
        self._port, self._within = port, within

    def close(self) -> None:
        """Release the port; nothing is said to the hand."""
        self._port.close()

    def ask(self, request: bytes, find: Callable[[bytes], T | None]) -> T | None:
        """Send a request once, and look for its reply in all that comes; None without a usable one in time.

        Raises:
            NoAnswerError: The port is gone.
        """
        self.counts.requests += 1
        self._port.drop_received()
        received, end, late = b"", time.monotonic() + self._within, False
        if self._port.send(request):
            while not late:
                late = time.monotonic() >= end  # asked first, so that a process that was held up looks once more
                received += self._port.receive()
                if (found := find(received)) is not None:
                    return found
        self.counts.unanswered += 1
        return None


def is_tcp(path: str) -> bool:
    """Whether a hand's port is a TCP address, not a serial port."""
    return path.startswith("tcp://")


def tcp_address(path: str) -> tuple[str, int]:
    """Split `tcp://HOST:PORT` into host and number of the port.

    Raises:
        ConfigError: It has another form.
    """
    host, _, number = path.removeprefix("tcp://").rpartition(":")
    if not is_tcp(path) or not host or not number.isdecimal() or int(number) > 0xFFFF:
        raise ConfigError(f"hand.port {path!r} is not an address: give tcp://HOST:PORT", code="config.hand_port")
    return host, int(number)


def serial_ports() -> list[str]:
    """The serial ports of this computer: by the names that stay the same, where the system has such."""
    named = sorted(str(path) for path in _BY_ID.iterdir()) if _BY_ID.is_dir() else []
    return named or sorted(port.device for port in comports())
