"""A websocket with the errors of a hand's: it cannot be opened, or is gone.

`websockets` knows the protocol; the socket is read here, in the thread of whoever uses it, so that nothing waits in
other threads and a connection that ends is known at once.
"""

from __future__ import annotations

import select
import socket
import time
from contextlib import suppress

from websockets.client import ClientProtocol
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI
from websockets.frames import Frame, Opcode
from websockets.protocol import State
from websockets.uri import parse_uri

from toolee_robot.errors import ConfigError, NoAnswerError, words_of

OPEN_TIME, SEND_TIME = 3.0, 0.5
"""Longest time for connecting, and for a message to go out [s]."""
LARGEST = 2**20
"""Size of the largest message that is taken [bytes]."""
_PIECE = 2**16


class Connection:
    """The websocket of a hand's rosbridge; one thread may use it.

    Args:
        url: Its address, such as `ws://127.0.0.1:9090`.

    Attributes:
        url: Its address.

    Raises:
        ConfigError: It is no such address.
        NoAnswerError: Nobody answers there, or no rosbridge does.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        try:
            address = parse_uri(url)
        except InvalidURI as error:
            raise _no_address(url) from error
        if address.secure:
            raise _no_address(url)
        self._protocol = ClientProtocol(address, max_size=LARGEST)
        self._pieces: list[bytes] = []
        try:
            self._socket = socket.create_connection((address.host, address.port), OPEN_TIME)
            try:
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._shake_hands()
            except BaseException:
                self._socket.close()
                raise
        except (OSError, InvalidHandshake, EOFError) as error:
            message = f"no rosbridge answers at {url}: {words_of(error)}; check hand.port, the network, and that"
            message += " rosbridge_websocket runs beside the hand"
            raise NoAnswerError(message, code="no_answer.hand_port") from error

    def close(self) -> None:
        """Take leave; the hand stays as it is."""
        with suppress(OSError, ConnectionClosed):
            if self._protocol.state is State.OPEN:
                self._protocol.send_close(1000)
                self._flush()
        self._socket.close()

    def send(self, text: str) -> None:
        """Send a message.

        Args:
            text: The message.

        Raises:
            NoAnswerError: The connection is gone, or takes nothing any more.
        """
        try:
            self._protocol.send_text(text.encode())
            self._flush()
        except (ConnectionClosed, OSError) as error:
            raise self._gone(error) from error

    def receive(self, within: float) -> list[bytes]:
        """Return what has come, all of it; wait for the first message.

        Args:
            within: For how long at most [s].

        Returns:
            The messages; none if none came.

        Raises:
            NoAnswerError: The connection is gone.
        """
        end = time.monotonic() + within
        found: list[bytes] = []
        try:
            while self._readable(0.0 if found else end - time.monotonic()):
                found += self._take(self._socket.recv(_PIECE))
        except OSError as error:
            raise self._gone(error) from error
        if self._protocol.state is not State.OPEN and not found:
            raise self._gone(ConnectionError("it was closed"))
        return found

    def _readable(self, within: float) -> bool:
        if self._protocol.state is not State.OPEN:
            return False
        return bool(select.select([self._socket], [], [], max(0.0, within))[0])

    def _take(self, data: bytes) -> list[bytes]:
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        found = []
        for event in self._protocol.events_received():
            if isinstance(event, Frame) and event.opcode in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
                self._pieces.append(bytes(event.data))
                if event.fin:
                    found.append(b"".join(self._pieces))
                    self._pieces.clear()
        self._flush()
        return found

    def _shake_hands(self) -> None:
        self._socket.settimeout(OPEN_TIME)
        self._protocol.send_request(self._protocol.connect())
        self._flush()
        while self._protocol.state is State.CONNECTING and self._protocol.handshake_exc is None:
            self._take(self._socket.recv(_PIECE))
        if self._protocol.handshake_exc is not None:
            raise self._protocol.handshake_exc
        self._socket.settimeout(SEND_TIME)

    def _flush(self) -> None:
        for data in self._protocol.data_to_send():
            if data:
                self._socket.sendall(data)
            else:
                with suppress(OSError):  # it may be gone already
                    self._socket.shutdown(socket.SHUT_WR)

    def _gone(self, error: Exception) -> NoAnswerError:
        message = f"the connection to the hand at {self.url} is gone ({words_of(error)}): see that rosbridge and"
        return NoAnswerError(f"{message} the hand run, then start again", code="no_answer.hand_unplugged")


def _no_address(url: str) -> ConfigError:
    message = f"hand.port is {url!r}: give the address of a rosbridge, ws://HOST:9090"
    return ConfigError(message, code="config.hand_port")
