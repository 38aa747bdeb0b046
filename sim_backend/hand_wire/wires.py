"""What an emulated hand's bytes go through: a pseudo-terminal, or a TCP connection."""

from __future__ import annotations

import os
import socket
import time
import tty
from abc import ABC, abstractmethod

from toolee_robot.errors import UserError, words_of

_CHUNK = 4096
_SEND_TIME = 1.0
"""Time after which a driver that reads nothing is let go [s]."""


def listener(address: tuple[str, int]) -> socket.socket:
    """Listen for drivers.

    Args:
        address: Host and port to listen at; port 0 for a free one.

    Returns:
        The socket.

    Raises:
        UserError: It cannot listen there.
    """
    try:
        return socket.create_server(address, backlog=1)
    except (OSError, OverflowError) as error:
        host, port = address
        raise UserError(f"cannot listen at {host}:{port}: {words_of(error)}", code="user.address") from error


class Wire(ABC):
    """The hand's end of a wire.

    Attributes:
        port: What a driver opens.
    """

    port: str

    @abstractmethod
    def sources(self) -> list[int]:
        """File descriptors on which something may arrive."""

    @abstractmethod
    def receive(self, ready: list[int]) -> bytes | None:
        """Return what has come.

        Args:
            ready: The descriptors on which something has, not only of `sources`.

        Returns:
            The bytes; None where another driver has come, or the last one has gone.
        """

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Send bytes; where no driver is, they are lost."""

    @abstractmethod
    def close(self) -> None:
        """Pull the cable out: whoever has the port open gets an error."""


class PseudoTerminal(Wire):
    """A serial line."""

    def __init__(self) -> None:
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self.port = os.ttyname(self._theirs)

    def sources(self) -> list[int]:
        return [self._ours]

    def receive(self, ready: list[int]) -> bytes:
        return os.read(self._ours, _CHUNK) if self._ours in ready else b""

    def send(self, data: bytes) -> None:
        os.write(self._ours, data)

    def close(self) -> None:
        os.close(self._ours)
        os.close(self._theirs)


class TcpServer(Wire):
    """A server for one connection at a time; it ends another one at once.

    Args:
        address: Host and port to listen at; port 0 for a free one.
        grace: Time after the end of a connection for which it ends every other one at once, too [s].

    Raises:
        UserError: It cannot listen there.
    """

    def __init__(self, address: tuple[str, int], grace: float) -> None:
        self._listener = listener(address)
        host, port = self._listener.getsockname()[:2]
        self.port = f"tcp://{host}:{port}"
        self._grace, self._free_from = grace, 0.0
        self._driver: socket.socket | None = None

    def sources(self) -> list[int]:
        return [end.fileno() for end in (self._listener, self._driver) if end is not None]

    def receive(self, ready: list[int]) -> bytes | None:
        if self._listener.fileno() in ready:
            return self._accept()
        if self._driver is None or self._driver.fileno() not in ready:
            return b""
        try:
            data = self._driver.recv(_CHUNK)
        except OSError:
            data = b""
        if data:
            return data
        self._end()
        return None

    def send(self, data: bytes) -> None:
        if self._driver is not None:
            try:
                self._driver.sendall(data)
            except OSError:
                self._end()

    def close(self) -> None:
        self._listener.close()
        if self._driver is not None:
            self._driver.close()

    def _accept(self) -> bytes | None:
        connection, _ = self._listener.accept()
        if self._driver is not None or time.monotonic() < self._free_from:
            connection.close()
            return b""
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(_SEND_TIME)
        self._driver = connection
        return None

    def _end(self) -> None:
        assert self._driver is not None
        self._driver.close()
        self._driver, self._free_from = None, time.monotonic() + self._grace
