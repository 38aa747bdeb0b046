"""A listening port of the controller and the sessions of its clients."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from toolee_robot.errors import UserError
from toolee_robot.sim_backend.ur_controller.server.link import Connection, LinkFaults

CLIENTS = 16  # connections a port serves at once; more are closed at the door
WAITING = 128  # connections that wait for the door; the kernel has the others try again a second later


class Session(Protocol):
    """One client's side of a protocol."""

    def feed(self, data: bytes) -> None:
        """Bytes from the client, cut anywhere."""

    def tick(self) -> None:
        """A controller tick has been done."""

    def close(self) -> None:
        """The client has gone."""


class Port:
    """A Service for one TCP port. session: makes the protocol's side of a new connection."""

    def __init__(
        self,
        name: str,
        host: str,
        number: int,
        session: Callable[[Connection], Session],
        log: Callable[[str], None],
    ) -> None:
        self.name, self.host, self.number = name, host, number
        self.faults = LinkFaults()
        self.clients: list[tuple[Connection, Session]] = []
        self._make_session, self._log = session, log
        self._listener: socket.socket | None = None

    def listen(self) -> None:
        """Raises UserError when the port is taken or the address is not this machine's."""
        if self._listener is not None:
            return
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((self.host, self.number))
            listener.listen(WAITING)
        except OSError as error:
            listener.close()
            raise UserError(
                f"cannot listen on {self.host}:{self.number} ({self.name}): {error.strerror}. Is another controller "
                "running there? End it, or choose another address, for example --host 127.0.0.3."
            ) from error
        listener.setblocking(False)
        self._listener = listener

    def refuse(self) -> None:
        """Stop listening; open connections stay."""
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def filenos(self) -> Sequence[int]:
        now = time.monotonic()
        found = [connection.fileno() for connection, _ in self.clients if connection.readable(now)]
        if self._listener is not None and now >= self.faults.stalled_until:
            found.append(self._listener.fileno())
        return found

    def on_readable(self, fd: int) -> None:
        if self._listener is not None and fd == self._listener.fileno():
            self._accept(self._listener)
            return
        for connection, session in self.clients:
            if connection.open and connection.fileno() == fd:
                data = connection.receive()
                if data is None:
                    connection.close()
                elif data:
                    session.feed(data)
                break
        self._forget_closed()

    def on_tick(self, dt: float) -> None:  # noqa: ARG002
        for connection, session in self.clients:
            connection.flush()
            session.tick()
        self._forget_closed()

    def drop(self, reset: bool = False) -> None:
        """Close every connection, with RST if `reset`."""
        for connection, _ in self.clients:
            connection.close(reset)
        self._forget_closed()

    def close(self) -> None:
        self.refuse()
        self.drop()

    def _accept(self, listener: socket.socket) -> None:
        try:
            sock, (host, port) = listener.accept()
        except OSError:  # the client has gone again
            return
        if len(self.clients) >= CLIENTS:
            self._log(f"{self.name}: {CLIENTS} clients are connected, {host} is turned away")
            sock.close()
            return
        connection = Connection(sock, f"{host}:{port}", self.faults)
        self.clients.append((connection, self._make_session(connection)))
        self._log(f"{self.name}: {connection.peer} connected")

    def _forget_closed(self) -> None:
        for client in [client for client in self.clients if not client[0].open]:
            self.clients.remove(client)
            client[1].close()
            self._log(f"{self.name}: {client[0].peer} gone")
