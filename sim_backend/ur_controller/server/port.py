"""A listening port of the controller and its connections: non-blocking, with injectable faults of the network."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from toolee_robot.errors import UserError, words_of


class Service(Protocol):
    """File descriptors that the loop waits on, and callbacks, which must not block."""

    def filenos(self) -> Sequence[int]:
        """Descriptors to wait on for reading."""

    def on_readable(self, fd: int) -> None:
        """Called when a descriptor of `filenos()` is readable."""

    def on_tick(self, dt: float) -> None:
        """Called after each tick of dt [s], with physics and safety up to date."""

    def close(self) -> None:
        """Called when the controller ends."""


PENDING_LIMIT = 4 << 20  # [bytes] unread by the client above which it is dropped
READ_SIZE = 512  # [bytes] per read: 4 kB of one-line programs delayed a tick by 0.1 to 0.65 s


@dataclass
class LinkFaults:
    """Network faults of a port, for all its connections.

    Attributes:
        stalled_until: Time before which nothing is read or sent [s of `time.monotonic()`]; afterwards everything comes
            in one burst.
        delay: Delay of everything sent [s].
        coalesce: Number of sends that are combined into one.
        truncate: Length to which the next send is truncated [bytes]; None for no truncation.
    """

    stalled_until: float = 0.0
    delay: float = 0.0
    coalesce: int = 1
    truncate: int | None = None


class Sink(Protocol):
    """What a session needs of its connection."""

    @property
    def backlog(self) -> int:
        """Bytes that the client has not read yet."""

    def send(self, data: bytes) -> None:
        """Send without blocking."""

    def close(self, reset: bool = False) -> None:
        """Close the connection, with RST if `reset`."""


class Connection:
    """A client's socket.

    Args:
        sock: The accepted socket.
        peer: The client's address, for the log.
        faults: Faults of the port.

    Attributes:
        peer: The client's address, for the log.
        open: Whether the connection is open.
        half_open: Fault: whether nothing is read or sent although the socket stays open, as with a dead network.
    """

    def __init__(self, sock: socket.socket, peer: str, faults: LinkFaults) -> None:
        sock.setblocking(False)
        with contextlib.suppress(OSError):  # not TCP (a socket pair in a test)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.peer = peer
        self.open = True
        self.half_open = False
        self._sock, self._faults = sock, faults
        self._queue: deque[tuple[float, bytes]] = deque()  # due [s], data
        self._pending = bytearray()  # due, and not accepted by the kernel yet
        self._held: list[bytes] = []  # waiting to be coalesced

    def fileno(self) -> int:
        """The socket's descriptor."""
        return self._sock.fileno()

    def readable(self, now: float) -> bool:
        """Whether the loop should wait for data on it at time `now` [s]."""
        return self.open and not self.half_open and now >= self._faults.stalled_until

    @property
    def backlog(self) -> int:
        """Bytes that the client has not read yet."""
        return len(self._pending) + sum(len(data) for _, data in self._queue)

    def receive(self) -> bytes | None:
        """Received bytes, possibly none; None once the client has closed or reset the connection."""
        try:
            data = self._sock.recv(READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError:
            return None
        return data or None

    def send(self, data: bytes) -> None:
        """Send, subject to the faults, without blocking; a client that does not read is dropped."""
        if not self.open or self.half_open:
            return
        faults, now = self._faults, time.monotonic()
        if faults.truncate is not None:
            data, faults.truncate = data[: faults.truncate], None
        if faults.coalesce > 1 or self._held:
            self._held.append(data)
            if len(self._held) < faults.coalesce:
                return
            data = b"".join(self._held)
            self._held.clear()
        if faults.delay > 0.0 or self._queue or now < faults.stalled_until:
            self._queue.append((now + faults.delay, data))
        else:
            self._write(data)
        if self.backlog > PENDING_LIMIT:
            self.close()

    def flush(self) -> None:
        """Send what is due."""
        now = time.monotonic()
        if not self.open or self.half_open or now < self._faults.stalled_until:
            return
        if self._pending:
            self._write(b"")
        while self._queue and self._queue[0][0] <= now:
            self._write(self._queue.popleft()[1])

    def _write(self, data: bytes) -> None:
        # Data behind unsent data are only queued: a send per packet would delay the tick with megabytes queued.
        full = bool(self._pending) and bool(data)
        self._pending += data
        if full or not self._pending:
            return
        try:
            del self._pending[: self._sock.send(self._pending)]
        except BlockingIOError:
            pass
        except OSError:
            self.close()

    def close(self, reset: bool = False) -> None:
        """Close the connection: with FIN, or with RST if `reset`."""
        if not self.open:
            return
        self.open = False
        with contextlib.suppress(OSError):
            if reset:
                self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._sock.close()


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
