"""TCP with deadlines (values of `time.monotonic()`); network errors are raised as `NoAnswerError`."""

from __future__ import annotations

import socket
import struct
import threading
import time
from contextlib import suppress

from toolee_robot.errors import NoAnswerError, words_of
from toolee_robot.runtime.readable import readable

_CHUNK = 65536
_SO_TIMESTAMPNS, _STAMP = 35, struct.Struct("@qq")  # Linux, socket(7); on the wall clock


def remaining(deadline: float) -> float:
    """Seconds until `deadline` (a value of `time.monotonic()`), at least 1 ms so that a ready socket is still read."""
    return max(deadline - time.monotonic(), 1e-3)


def resolve(host: str, deadline: float) -> str:
    """Resolve a host name in a thread, since the system's resolver has no time limit.

    Args:
        host: Host name or IPv4 address.
        deadline: Deadline [s], a value of `time.monotonic()`.

    Returns:
        The IPv4 address.

    Raises:
        NoAnswerError: The name is unknown, or not resolved in time.
    """
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
        message = f"no address is known for the host {host!r}: give the robot's IP address"
        raise NoAnswerError(message, code="no_answer.host_unknown")
    return found[0]


def connect(host: str, port: int, deadline: float) -> socket.socket:
    """Connect, with Nagle's algorithm disabled and receive time stamps enabled.

    Args:
        host: Host name or IPv4 address.
        port: TCP port.
        deadline: Deadline [s], a value of `time.monotonic()`.

    Returns:
        The connected socket.

    Raises:
        NoAnswerError: The connection is refused or not established in time.
    """
    address = resolve(host, deadline)
    try:
        sock = socket.create_connection((address, port), timeout=remaining(deadline))
    except TimeoutError as error:
        raise NoAnswerError(f"{host}:{port} does not answer", code="no_answer.timeout") from error
    except OSError as error:
        raise NoAnswerError(f"{host}:{port}: {words_of(error)}", code="no_answer.connect") from error
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    return sock


def send(sock: socket.socket, data: bytes, deadline: float) -> None:
    """Send all of the data.

    Args:
        sock: The connected socket.
        data: What to send.
        deadline: Deadline [s], a value of `time.monotonic()`.

    Raises:
        NoAnswerError: The connection broke, or the deadline passed.
    """
    try:
        sock.settimeout(remaining(deadline))
        sock.sendall(data)
    except OSError as error:
        message = f"the connection broke while sending: {words_of(error)}"
        raise NoAnswerError(message, code="no_answer.connection_lost") from error


def receive(sock: socket.socket, deadline: float) -> bytes:
    """Receive at least one byte.

    Args:
        sock: The connected socket.
        deadline: Deadline [s], a value of `time.monotonic()`.

    Returns:
        What was received.

    Raises:
        NoAnswerError: The connection broke, the peer closed it, or the deadline passed.
    """
    try:
        data = sock.recv(_CHUNK) if readable([sock.fileno()], remaining(deadline)) else None
    except (OSError, ValueError) as error:
        raise NoAnswerError(f"the connection broke: {words_of(error)}", code="no_answer.connection_lost") from error
    if data is None:
        raise NoAnswerError("no answer in time", code="no_answer.timeout")
    if not data:
        raise NoAnswerError("the peer closed the connection", code="no_answer.connection_lost")
    return data


def receive_now(sock: socket.socket) -> tuple[bytes, float]:
    """Receive what has arrived; never waits.

    Args:
        sock: Connected socket, made by `connect`.

    Returns:
        The bytes, possibly none, and when the last of them arrived, by the kernel's time stamp [s]; a value of
        `time.monotonic()`.

    Raises:
        NoAnswerError: The connection is broken or closed.
    """
    sock.setblocking(False)
    try:
        data, control, _, _ = sock.recvmsg(_CHUNK, socket.CMSG_SPACE(_STAMP.size))
    except BlockingIOError:
        return b"", time.monotonic()
    except OSError as error:
        raise NoAnswerError(f"the connection broke: {words_of(error)}", code="no_answer.connection_lost") from error
    if not data:
        raise NoAnswerError("the peer closed the connection", code="no_answer.connection_lost")
    for level, kind, stamp in control:
        if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS) and len(stamp) == _STAMP.size:
            seconds, nanoseconds = _STAMP.unpack(stamp)
            return data, time.monotonic() - max(time.time() - (seconds + 1e-9 * nanoseconds), 0.0)
    return data, time.monotonic()
