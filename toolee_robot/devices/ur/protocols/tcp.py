"""The controller's dashboard, primary interface and sockets."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from toolee_robot.errors import NoAnswerError, ProtocolError, words_of
from toolee_robot.frames import Array
from toolee_robot.runtime.clock import readable

if TYPE_CHECKING:
    from toolee_robot.robots.urdf import DhParameters

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


DASHBOARD_PORT = 29999
_MAX_LINE = 4096  # [bytes]

Question = Literal[
    "PolyscopeVersion",
    "get robot model",
    "get serial number",
    "is in remote control",
    "robotmode",
    "safetymode",
    "running",
]


class DashboardReader:
    """A connection to the dashboard server whose greeting has been read.

    Args:
        sock: Connected socket; the caller closes it.
        deadline: Deadline of the greeting [s], a value of `time.monotonic()`.

    Raises:
        NoAnswerError: There is no greeting in time.
        ProtocolError: The peer is no dashboard server.
    """

    def __init__(self, sock: socket.socket, deadline: float) -> None:
        self._sock = sock
        self._bytes = bytearray()
        greeting = self._line(deadline)
        if "dashboard" not in greeting.lower():
            message = f"port {DASHBOARD_PORT} greets with {greeting[:60]!r}: this is no dashboard server"
            raise ProtocolError(message)

    def ask(self, question: Question, deadline: float) -> str | None:
        """Ask one question.

        Args:
            question: The command to send.
            deadline: Deadline of the answer [s], a value of `time.monotonic()`.

        Returns:
            The answer, or None if this version of PolyScope does not know the question.

        Raises:
            NoAnswerError: There is no answer in time.
            ProtocolError: The answer is not a line of text.
        """
        send(self._sock, question.encode() + b"\n", deadline)
        answer = self._line(deadline).strip()
        return None if answer.lower().startswith(("could not understand", "unknown command")) else answer

    def _line(self, deadline: float) -> str:
        while b"\n" not in self._bytes:
            if len(self._bytes) > _MAX_LINE:
                message = "the dashboard server sends a line without end: this is no dashboard server"
                raise ProtocolError(message, code="protocol.line_too_long")
            self._bytes += receive(self._sock, deadline)
        line, _, rest = self._bytes.partition(b"\n")
        self._bytes = bytearray(rest)
        try:
            return line.decode("utf-8")
        except UnicodeDecodeError as error:
            raise ProtocolError("the dashboard server's answer is not text", code="protocol.not_text") from error


def ask_all(host: str, questions: Sequence[Question], deadline: float) -> dict[Question, str | None]:
    """Connect and ask several questions.

    Args:
        host: Address of the controller.
        questions: The commands to send.
        deadline: Deadline of all answers [s], a value of `time.monotonic()`.

    Returns:
        The answer to each question; None where this version of PolyScope does not know it.

    Raises:
        NoAnswerError: The server does not answer in time.
        ProtocolError: The peer is no dashboard server.
    """
    with connect(host, DASHBOARD_PORT, deadline) as sock:
        reader = DashboardReader(sock, deadline)
        return {question: reader.ask(question, deadline) for question in questions}


PRIMARY_PORT = 30001

_ROBOT_STATE, _KINEMATICS_INFO, _CONFIGURATION_DATA = 16, 5, 6
_ROBOT_MESSAGE, _ERROR_CODE = 20, 6
_HEADER = struct.Struct(">iB")
_ERROR = struct.Struct(">QbBiiiII")  # time stamp, source, kind; code, argument, report level, type and value of data
_WARNING, _FOR_DEVELOPERS = 2, 128  # report levels: debug 0, info 1, warning 2, violation 3, fault 4, critical fault 5
_CONTENT = struct.Struct(">6I24dI")
_LIMITS = struct.Struct(">24d")  # of each joint the least and largest position, then of each speed and acceleration
_IMPLAUSIBLE = 1e4  # [m, rad]; joints 2 to 4 are parallel, so a calibration may shift them by metres
_MAX_MESSAGE = 1 << 20  # [bytes]; a robot state message has about 1,500


@dataclass(frozen=True)
class JointRanges:
    """What the controller permits its joints, beyond which it stops the arm.

    The layout is published (Client Interfaces 3.14 and 5.9, Configuration Data). That the values are those of the
    safety configuration is what UR's forum says (thread 1919), not the manual.

    Attributes:
        lower: Least position of each joint, (6,) [rad].
        upper: Largest position, (6,) [rad].
        speed: Largest speed, (6,) [rad/s].
    """

    lower: Array
    upper: Array
    speed: Array


@dataclass(frozen=True)
class UrKinematics:
    """Kinematics of one arm.

    Attributes:
        checksum: Checksum of each joint's calibration, six values; identifies the arm.
        dh: Denavit-Hartenberg parameters, nominal values plus corrections.
        ranges: What the joints may do; None if the controller does not report it.
    """

    checksum: tuple[int, ...]
    dh: DhParameters
    ranges: JointRanges | None = None


@dataclass(frozen=True)
class ControllerError:
    """An error of the controller, as its log shows it.

    Attributes:
        code: Number of the error.
        argument: What it applies to, such as the joint; its meaning depends on the code.
        level: Report level: 2 a warning, 3 a violation, 4 a fault, 5 a critical fault.
        text: Text of the message; may be empty.
    """

    code: int
    argument: int
    level: int
    text: str

    @property
    def name(self) -> str:
        """The code as the pendant's log shows it, such as C173A2."""
        return f"C{self.code}A{self.argument}"

    @property
    def serious(self) -> bool:
        """Whether it may explain a stop: no information, and nothing for the controller's developers."""
        return _WARNING <= self.level < _FOR_DEVELOPERS


def read_kinematics(host: str, deadline: float) -> UrKinematics:
    """Connect and read the kinematics.

    Args:
        host: Address of the controller.
        deadline: Deadline [s], a value of `time.monotonic()`.

    Returns:
        The arm's kinematics.

    Raises:
        NoAnswerError: The controller does not send them in time.
        ProtocolError: The peer is no primary interface, or the values are implausible.
    """
    with connect(host, PRIMARY_PORT, deadline) as sock:
        return kinematics_from(sock, deadline)


def kinematics_from(sock: socket.socket, deadline: float) -> UrKinematics:
    """Read the kinematics from a connected socket.

    Args:
        sock: Socket that is connected to the primary interface.
        deadline: Deadline [s], a value of `time.monotonic()`.

    Returns:
        The kinematics, see `read_kinematics`.
    """
    buffer = bytearray()
    while True:
        buffer += receive(sock, deadline)
        for kind, content in _messages(buffer):
            if kind != _ROBOT_STATE:
                continue
            parts = dict(_messages(bytearray(content)))
            if _KINEMATICS_INFO in parts:
                return _parse(parts[_KINEMATICS_INFO], parts.get(_CONFIGURATION_DATA, b""))


def errors_in(buffer: bytearray) -> list[ControllerError]:
    """Take the errors out of what was received.

    Args:
        buffer: Received bytes, from the beginning of a message on; the complete messages are removed.

    Returns:
        The errors, in their order.

    Raises:
        ProtocolError: The bytes are no messages of a primary interface.
    """
    errors = []
    for kind, content in _messages(buffer):
        if kind != _ROBOT_MESSAGE or len(content) < _ERROR.size:
            continue
        _, _, what, code, argument, level, _, _ = _ERROR.unpack_from(content)
        if what == _ERROR_CODE:
            text = content[_ERROR.size :].decode("ascii", "replace").strip("\0 ")
            errors.append(ControllerError(code, argument, level, text))
    return errors


def _messages(buffer: bytearray) -> Iterator[tuple[int, bytes]]:
    """Remove the complete messages, or sub-packages, from the front of the buffer and yield type and content."""
    while len(buffer) >= _HEADER.size:
        size, kind = _HEADER.unpack_from(buffer)
        if not _HEADER.size <= size <= _MAX_MESSAGE:
            message = f"a message of {size} bytes: this is no primary interface of a UR controller"
            raise ProtocolError(message, code="protocol.message_size")
        if len(buffer) < size:
            return
        content = bytes(buffer[_HEADER.size : size])
        del buffer[:size]
        yield kind, content


def _parse(content: bytes, configuration: bytes) -> UrKinematics:
    if len(content) < _CONTENT.size:  # newer versions may append fields
        message = f"kinematics info of {len(content)} bytes, expected {_CONTENT.size}"
        raise ProtocolError(message, code="protocol.message_size")
    values = _CONTENT.unpack_from(content)
    theta, a, d, alpha = np.array(values[6:30], float).reshape(4, 6)
    if not all(np.all(np.abs(v) < _IMPLAUSIBLE) for v in (theta, a, d, alpha)):
        raise ProtocolError("the controller's kinematics are not finite, or implausible", code="protocol.implausible")
    from toolee_robot.robots.urdf import DhParameters  # loads meshes: not in the servo process, nor in its watch

    return UrKinematics(tuple(values[:6]), DhParameters(d=d, a=a, alpha=alpha, theta=theta), _ranges(configuration))


def _ranges(content: bytes) -> JointRanges | None:
    if len(content) < _LIMITS.size:
        return None
    (lower, upper), (speed, _) = np.moveaxis(np.reshape(_LIMITS.unpack_from(content), (2, 6, 2)), 1, 2)
    plausible = np.all(np.abs([lower, upper, speed]) < _IMPLAUSIBLE) and np.all(lower < upper) and np.all(speed > 0.0)
    if not plausible:
        message = "the limits of the controller's joints are not finite, or implausible"
        raise ProtocolError(message, code="protocol.implausible")
    return JointRanges(lower, upper, speed)
