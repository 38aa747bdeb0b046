"""The arm's own kinematics, as the factory measured them: the controller tells them on its primary interface.

    kinematics = read_kinematics("192.168.1.10", deadline=time.monotonic() + 1.0)

Read only: nothing is sent, so no program is touched. The controller sends robot state messages (type 16) of
sub-packages at 10 Hz; "kinematics info" (type 5) comes with the first ones and not in every one.

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
_IMPLAUSIBLE = 1e4  # [m, rad]; joints 2 to 4 are parallel, and a calibration may shift them by metres
_LARGEST = 1 << 20  # [bytes] of a message; a robot state has some 1,500


@dataclass(frozen=True)
class UrKinematics:
    """checksum: (6,) of each joint's calibration, identifies the arm. dh: nominal values and corrections summed."""

    checksum: tuple[int, ...]
    dh: DhParameters


def read_kinematics(host: str, deadline: float, port: int = PRIMARY_PORT) -> UrKinematics:
    """Listen until the controller tells. Raises NoAnswerError when it does not, ProtocolError for other bytes."""
    with connect(host, port, deadline) as sock:
        return kinematics_from(sock, deadline)


def kinematics_from(sock: socket.socket, deadline: float) -> UrKinematics:
    """As `read_kinematics`, from a connected socket."""
    buffer = bytearray()
    while True:
        buffer += receive(sock, deadline)
        for kind, content in _messages(buffer):
            if kind != _ROBOT_STATE:
                continue
            found = next((part for sub, part in _messages(bytearray(content)) if sub == _KINEMATICS_INFO), None)
            if found is not None:
                return _parse(found)


def _messages(buffer: bytearray) -> Iterator[tuple[int, bytes]]:
    """Take whole messages, or sub-packages, off the front of the buffer."""
    while len(buffer) >= _HEADER.size:
        size, kind = _HEADER.unpack_from(buffer)
        if not _HEADER.size <= size <= _LARGEST:
            raise ProtocolError(f"a message of {size} bytes: this is no primary interface of a UR controller")
        if len(buffer) < size:
            return
        content = bytes(buffer[_HEADER.size : size])
        del buffer[:size]
        yield kind, content


def _parse(content: bytes) -> UrKinematics:
    if len(content) < _CONTENT.size:  # newer versions may add fields behind
        raise ProtocolError(f"kinematics info of {len(content)} bytes where {_CONTENT.size} were due")
    values = _CONTENT.unpack_from(content)
    theta, a, d, alpha = np.array(values[6:30], float).reshape(4, 6)
    if not all(np.all(np.abs(v) < _IMPLAUSIBLE) for v in (theta, a, d, alpha)):
        raise ProtocolError("the controller's kinematics are not finite, or absurd")
    return UrKinematics(tuple(values[:6]), DhParameters(d=d, a=a, alpha=alpha, theta=theta))
