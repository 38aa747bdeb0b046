"""The TCP connection to a hand, with the same errors as a serial port."""

from __future__ import annotations

import select
import socket
from collections.abc import Iterator
from contextlib import contextmanager

from toolee_robot.errors import ConfigError, NoAnswerError, words_of

CONNECT_TIME = 1.0
"""Time to connect [s]."""
_SCHEME = "tcp://"
_READ_TIME = 0.01
_CHUNK = 4096
_MOST_DROPPED = 64
"""Chunks, if somebody talks without end."""


def is_tcp(port: str) -> bool:
    """Whether a hand's port is a TCP address, not a serial port."""
    return port.startswith(_SCHEME)


def tcp_address(port: str) -> tuple[str, int]:
    """Split a hand's port.

    Args:
        port: `tcp://HOST:PORT`.

    Returns:
        Host and number of the port.

    Raises:
        ConfigError: It has another form.
    """
    host, _, number = port.removeprefix(_SCHEME).rpartition(":")
    if not is_tcp(port) or not host or not number.isdecimal() or int(number) > 0xFFFF:
        message = f"hand.port {port!r} is no address: give tcp://HOST:PORT, as delivered tcp://192.168.11.210:6000"
        raise ConfigError(message, code="config.hand_port")
    return host, int(number)


class TcpPort:
    """The TCP connection to a hand; one thread may use it. It is never made again by itself.

    Args:
        port: `tcp://HOST:PORT`.
        write_time: Longest time for sending [s].

    Attributes:
        path: The port.

    Raises:
        NoAnswerError: Nobody can be connected to.
        ConfigError: The port has another form.
    """

    def __init__(self, port: str, write_time: float) -> None:
        self.path = port
        try:
            self._socket = socket.create_connection(tcp_address(port), CONNECT_TIME)
        except OSError as error:
            message = f"cannot connect to the hand at {port}: {words_of(error)}; check hand.port, its power, the cable"
            message += ", and that this computer has an address in the hand's network"
            raise NoAnswerError(message, code="no_answer.hand_port") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(write_time)

    def close(self) -> None:
        """End the connection; nothing is said to the hand."""
        self._socket.close()

    def send(self, data: bytes) -> bool:
        """Send bytes.

        Args:
            data: The bytes.

        Returns:
            Whether they went out in time; otherwise none of them did.

        Raises:
            NoAnswerError: The connection is gone, or took a part of them only.
        """
        with self._watched():
            try:
                sent = self._socket.send(data)
            except TimeoutError:
                return False
            if sent < len(data):
                raise ConnectionAbortedError("the hand takes no more bytes")
        return True

    def receive(self) -> bytes:
        """Return what has come; wait for the first byte for 0.01 s at most.

        Returns:
            The bytes; none if none came.

        Raises:
            NoAnswerError: The connection is gone.
        """
        with self._watched():
            return self._received() if select.select([self._socket], [], [], _READ_TIME)[0] else b""

    def drop_received(self) -> None:
        """Forget what has come.

        Raises:
            NoAnswerError: The connection is gone.
        """
        with self._watched():
            for _ in range(_MOST_DROPPED):
                if not select.select([self._socket], [], [], 0.0)[0]:
                    break
                self._received()

    def _received(self) -> bytes:
        data = self._socket.recv(_CHUNK)
        if not data:
            raise ConnectionResetError("the hand has closed it")
        return data

    @contextmanager
    def _watched(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError) as error:  # ValueError: select, of a socket that was closed meanwhile
            message = (
                f"the connection to the hand at {self.path} is gone ({words_of(error)}): check its power and its cable"
            )
            raise NoAnswerError(f"{message}, then start again", code="no_answer.hand_unplugged") from error
