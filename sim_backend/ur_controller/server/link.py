"""An accepted connection: non-blocking, with injectable faults of the network."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections import deque
from dataclasses import dataclass
from typing import Protocol

PENDING_LIMIT = 4 << 20  # [bytes] unread by the client above which it is dropped
READ_SIZE = 4096  # [bytes] per read: a flood of tiny packets must not delay the tick


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
