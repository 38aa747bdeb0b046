"""TCP with a deadline: every call ends by it, and what the network says becomes one of our errors."""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
from contextlib import suppress

from toolee_robot.errors import NoAnswerError

_CHUNK = 65536
_SO_TIMESTAMPNS, _STAMP = 35, struct.Struct("@qq")  # Linux, socket(7); of the wall's clock


def remaining(deadline: float) -> float:
    """Seconds until `deadline` (a value of `time.monotonic()`), at least 1 ms so that a ready socket is still read."""
    return max(deadline - time.monotonic(), 1e-3)


def resolve(host: str, deadline: float) -> str:
    """IPv4 address of a host; the resolver, which takes no time limit, runs beside. Raises NoAnswerError."""
    with suppress(OSError):
        socket.inet_pton(socket.AF_INET, host)
        return host
    found: list[str] = []

    def ask() -> None:
        with suppress(OSError, UnicodeError):
            found.append(socket.gethostbyname(host))

    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    thread.join(remaining(deadline))
    if not found:
        raise NoAnswerError(f"no address is known for the host {host!r}: give the robot's IP address")
    return found[0]


def connect(host: str, port: int, deadline: float) -> socket.socket:
    """A connected socket with Nagle's algorithm off. Raises NoAnswerError."""
    address = resolve(host, deadline)
    try:
        sock = socket.create_connection((address, port), timeout=remaining(deadline))
    except TimeoutError as error:
        raise NoAnswerError(f"{host}:{port} does not answer") from error
    except OSError as error:
        raise NoAnswerError(f"{host}:{port}: {error.strerror or error}") from error
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    return sock


def send(sock: socket.socket, data: bytes, deadline: float) -> None:
    """Send all of it. Raises NoAnswerError."""
    try:
        sock.settimeout(remaining(deadline))
        sock.sendall(data)
    except OSError as error:
        raise NoAnswerError(f"the connection broke while sending: {error.strerror or error}") from error


def receive(sock: socket.socket, deadline: float) -> bytes:
    """Whatever has come, at least one byte. Raises NoAnswerError."""
    try:
        ready, _, _ = select.select([sock], [], [], remaining(deadline))
        data = sock.recv(_CHUNK) if ready else None
    except (OSError, ValueError) as error:
        raise NoAnswerError(f"the connection broke: {error}") from error
    if data is None:
        raise NoAnswerError("no answer in time")
    if not data:
        raise NoAnswerError("the other side closed the connection")
    return data


def receive_now(sock: socket.socket) -> tuple[bytes, float]:
    """Whatever has come, which may be nothing, and when the last of it did, a value of `time.monotonic()`: by the
    kernel's own stamp, however late this is called. Never waits. Raises NoAnswerError."""
    sock.setblocking(False)
    try:
        data, control, _, _ = sock.recvmsg(_CHUNK, socket.CMSG_SPACE(_STAMP.size))
    except BlockingIOError:
        return b"", time.monotonic()
    except OSError as error:
        raise NoAnswerError(f"the connection broke: {error}") from error
    if not data:
        raise NoAnswerError("the other side closed the connection")
    for level, kind, stamp in control:
        if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS) and len(stamp) == _STAMP.size:
            seconds, nanoseconds = _STAMP.unpack(stamp)
            return data, time.monotonic() - max(time.time() - (seconds + 1e-9 * nanoseconds), 0.0)
    return data, time.monotonic()
