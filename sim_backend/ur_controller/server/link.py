"""One accepted connection: non-blocking, with the faults that a network or a controller's port can have."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections import deque
from dataclasses import dataclass
from typing import Protocol

PENDING_LIMIT = 4 << 20  # [bytes] that a client may leave unread before it is dropped
READ_SIZE = 4096  # [bytes] at a time: a flood of tiny packets must not hold up the tick


@dataclass
class LinkFaults:
    """What is wrong with a port, for all its connections.

    stalled_until [s]: nothing is read or sent before; it all comes in one burst afterwards, as after a stuck network.
    delay [s]: everything sent arrives this much later. coalesce: so many sends leave as one. truncate [bytes]: the
    next send loses everything after its first so many bytes; None: whole.
    """

    stalled_until: float = 0.0
    delay: float = 0.0
    coalesce: int = 1
    truncate: int | None = None


class Sink(Protocol):
    """What a session needs of its connection."""

    @property
    def backlog(self) -> int:
        """Bytes that the client has not taken yet."""
        ...

    def send(self, data: bytes) -> None: ...

    def close(self, reset: bool = False) -> None: ...


class Connection:
    """A client's socket. half_open: nothing is read or sent any more, the socket stays open (a dead network)."""

    def __init__(self, sock: socket.socket, peer: str, faults: LinkFaults) -> None:
        sock.setblocking(False)
        with contextlib.suppress(OSError):  # not TCP (a socket pair in a test)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.peer = peer
        self.open = True
        self.half_open = False
        self._sock, self._faults = sock, faults
        self._queue: deque[tuple[float, bytes]] = deque()  # due [s], data
        self._pending = bytearray()  # due, and not taken by the kernel yet
        self._held: list[bytes] = []  # waiting to be coalesced

    def fileno(self) -> int:
        return self._sock.fileno()

    def readable(self, now: float) -> bool:
        """Whether the loop should wait on it."""
        return self.open and not self.half_open and now >= self._faults.stalled_until

    @property
    def backlog(self) -> int:
        """Bytes that the client has not taken yet."""
        return len(self._pending) + sum(len(data) for _, data in self._queue)

    def receive(self) -> bytes | None:
        """What has come; empty if nothing has; None when the client has closed or reset the connection."""
        try:
            data = self._sock.recv(READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError:
            return None
        return data or None

    def send(self, data: bytes) -> None:
        """Send what the faults leave of it, now or later. Never blocks; a client that does not read is dropped."""
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
        """Send what has become due."""
        now = time.monotonic()
        if not self.open or self.half_open or now < self._faults.stalled_until:
            return
        if self._pending:
            self._write(b"")
        while self._queue and self._queue[0][0] <= now:
            self._write(self._queue.popleft()[1])

    def _write(self, data: bytes) -> None:
        # Not joined and sent again for every little packet: with megabytes waiting that would hold up the tick.
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
        """End the connection: with FIN, or with RST if `reset`."""
        if not self.open:
            return
        self.open = False
        with contextlib.suppress(OSError):
            if reset:
                self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._sock.close()
