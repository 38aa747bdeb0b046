"""A listening port of the controller and the sessions of its clients."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from toolee_robot.errors import UserError, words_of
from toolee_robot.sim_backend.ur_controller.server.link import Connection, LinkFaults

CLIENTS = 16  # connections of a port at once; further ones are closed
WAITING = 128  # length of the listen queue; the kernel lets further clients retry after a second


class Session(Protocol):
    """One client's side of a protocol."""

    def feed(self, data: bytes) -> None:
        """Take received bytes, split anywhere."""

    def tick(self) -> None:
        """Called after each tick of the controller."""

    def close(self) -> None:
        """Called when the client has closed the connection."""


class Port:
    """A `Service` for one TCP port.

    Args:
        name: Name of the port.
        host: Address to listen on.
        number: TCP port.
        session: Creates the session of a new connection.
        log: Called with each line of the log.

    Attributes:
        name: Name of the port.
        host: Address to listen on.
        number: TCP port.
        faults: Network faults of the port.
        clients: Open connections and their sessions.
    """

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
        """Open the port.

        Raises:
            UserError: The port is taken, or the address is not this machine's.
        """
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
                f"cannot listen on {self.host}:{self.number} ({self.name}): {words_of(error)}. Is another controller "
                "running there? End it, or choose another address, for example --host 127.0.0.3.",
                code="user.port_taken",
            ) from error
        listener.setblocking(False)
        self._listener = listener

    def refuse(self) -> None:
        """Stop listening; open connections stay."""
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def filenos(self) -> Sequence[int]:
        """Descriptors of the listener and the connections."""
        now = time.monotonic()
        found = [connection.fileno() for connection, _ in self.clients if connection.readable(now)]
        if self._listener is not None and now >= self.faults.stalled_until:
            found.append(self._listener.fileno())
        return found

    def on_readable(self, fd: int) -> None:
        """Accept a connection, or read from one."""
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
        """Send what is due, and let the sessions publish."""
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
        """Close the listener and every connection."""
        self.refuse()
        self.drop()

    def _accept(self, listener: socket.socket) -> None:
        try:
            sock, (host, port) = listener.accept()
        except OSError:  # the client has already gone
            return
        if len(self.clients) >= CLIENTS:
            self._log(f"{self.name}: {CLIENTS} clients are connected, {host} is refused")
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
