"""Read-only client of the primary interface: the arm's kinematics as calibrated by the factory.

    kinematics = read_kinematics("192.168.1.10", deadline=time.monotonic() + 1.0)

Nothing is sent, so no program is disturbed. The controller sends robot state messages (type 16) of sub-packages at
10 Hz; "kinematics info" (type 5) is contained in the first ones, but not in every one.

Source: Universal Robots, "Primary and Secondary Interfaces": every message is an int32 size (its own four bytes
included), a u8 type, and the content, big-endian; sub-packages likewise.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from toolee_robot.errors import ProtocolError
from toolee_robot.hardware.ur.protocols.tcp import connect, receive
from toolee_robot.robots.dh import DhParameters

PRIMARY_PORT = 30001

_ROBOT_STATE, _KINEMATICS_INFO = 16, 5
_HEADER = struct.Struct(">iB")
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
