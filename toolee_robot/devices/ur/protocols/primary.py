"""Read-only client of the primary interface: the arm's kinematics as calibrated by the factory, and its errors.

    kinematics = read_kinematics("192.168.1.10", deadline=time.monotonic() + 1.0)

Nothing is sent, so no program is disturbed. The controller sends robot state messages (type 16) of sub-packages at
10 Hz; "kinematics info" (type 5) is contained in the first ones, but not in every one. An error is a robot message
(type 20) of its own, sent when it occurs.

Source: Universal Robots, "Primary and Secondary Interfaces": every message is an int32 size (its own four bytes
included), a u8 type, and the content, big-endian; sub-packages likewise.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from toolee_robot.devices.ur.protocols.tcp import connect, receive
from toolee_robot.errors import ProtocolError
from toolee_robot.robots.dh import DhParameters

PRIMARY_PORT = 30001

_ROBOT_STATE, _KINEMATICS_INFO = 16, 5
_ROBOT_MESSAGE, _ERROR_CODE = 20, 6
_HEADER = struct.Struct(">iB")
_ERROR = struct.Struct(">QbBiiiII")  # time stamp, source, kind; code, argument, report level, type and value of data
_WARNING, _FOR_DEVELOPERS = 2, 128  # report levels: debug 0, info 1, warning 2, violation 3, fault 4, critical fault 5
_CONTENT = struct.Struct(">6I24dI")
_IMPLAUSIBLE = 1e4  # [m, rad]; joints 2 to 4 are parallel, so a calibration may shift them by metres
_MAX_MESSAGE = 1 << 20  # [bytes]; a robot state message has about 1,500


@dataclass(frozen=True)
class UrKinematics:
    """Kinematics of one arm.

    Attributes:
        checksum: Checksum of each joint's calibration, six values; identifies the arm.
        dh: Denavit-Hartenberg parameters, nominal values plus corrections.
    """

    checksum: tuple[int, ...]
    dh: DhParameters


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
            info = next((part for sub, part in _messages(bytearray(content)) if sub == _KINEMATICS_INFO), None)
            if info is not None:
                return _parse(info)


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


def _parse(content: bytes) -> UrKinematics:
    if len(content) < _CONTENT.size:  # newer versions may append fields
        message = f"kinematics info of {len(content)} bytes, expected {_CONTENT.size}"
        raise ProtocolError(message, code="protocol.message_size")
    values = _CONTENT.unpack_from(content)
    theta, a, d, alpha = np.array(values[6:30], float).reshape(4, 6)
    if not all(np.all(np.abs(v) < _IMPLAUSIBLE) for v in (theta, a, d, alpha)):
        raise ProtocolError("the controller's kinematics are not finite, or implausible", code="protocol.implausible")
    return UrKinematics(tuple(values[:6]), DhParameters(d=d, a=a, alpha=alpha, theta=theta))
