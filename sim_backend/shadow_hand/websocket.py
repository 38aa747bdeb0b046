"""The server's end of one websocket, read and written by a single thread."""

from __future__ import annotations

import socket
from contextlib import suppress

from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

SEND_TIME = 1.0
"""Longest time for a message to go out [s]; a client that takes nothing is dropped."""


class WebSocket:
    """A websocket that a client has opened.

    Args:
        connected: Its socket, just accepted.
    """

    def __init__(self, connected: socket.socket) -> None:
        connected.settimeout(SEND_TIME)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket, self._protocol = connected, ServerProtocol()
        self._pieces: list[bytes] = []
        self._cut = False

    def fileno(self) -> int:
        """Number of its socket, for `select`."""
        return self._socket.fileno()

    @property
    def open(self) -> bool:
        """Whether the client is there."""
        return not self._cut and self._protocol.state in (State.CONNECTING, State.OPEN)

    def receive(self) -> list[bytes]:
        """Take what has come.

        Returns:
            The messages that it completes.
        """
        try:
            data = self._socket.recv(2**16)
        except OSError:
            data = b""
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        found = []
        for event in self._protocol.events_received():
            if isinstance(event, Request):
                self._protocol.send_response(self._protocol.accept(event))
            elif isinstance(event, Frame) and event.opcode in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
                self._pieces.append(bytes(event.data))
                if event.fin:
                    found.append(b"".join(self._pieces))
                    self._pieces.clear()
        self._flush()
        return found

    def send(self, data: bytes) -> None:
        """Send a message as text, whatever it is; nothing happens if the client is gone.

        Args:
            data: Its bytes.
        """
        with suppress(ConnectionClosed):
            self._protocol.send_text(data)
            self._flush()

    def cut(self) -> None:
        """End the connection without taking leave."""
        self._cut = True
        self._socket.close()

    def _flush(self) -> None:
        try:
            for data in self._protocol.data_to_send():
                if data:
                    self._socket.sendall(data)
        except OSError:
            self._cut = True
