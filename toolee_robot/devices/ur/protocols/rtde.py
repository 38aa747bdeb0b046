"""A small read-only RTDE client: it subscribes to outputs, never to an input register, and moves nothing.

    with RtdeReader.connect("192.168.1.10", deadline=time.monotonic() + 2.0) as reader:
        version = reader.version(deadline)
        reader.subscribe(["timestamp", "actual_q"], 125.0, deadline)
        sample = reader.read(deadline)

Used before any motion instead of ur_rtde, whose constructors hold the interpreter's lock and have no time limit. Every
call ends by its deadline (a value of `time.monotonic()`) whatever the peer sends: with `ProtocolError` for bytes that
are no RTDE, with `NoAnswerError` for silence or a closed connection.

Protocol: Universal Robots' Real-Time Data Exchange guide, protocol version 2, port 30004. A packet is a big-endian u16
size (header included), a u8 type, and the payload.
"""

from __future__ import annotations

import socket
import struct
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

from toolee_robot.devices.ur.protocols.tcp import connect, receive, receive_now, send
from toolee_robot.errors import NoAnswerError, ProtocolError

RTDE_PORT = 30004
NOT_FOUND = "NOT_FOUND"

_PROTOCOL, _VERSION, _TEXT, _DATA, _OUTPUTS, _START = b"VvMUOS"
_HEADER = struct.Struct(">HB")
_FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}

Value = bool | int | float | tuple[float, ...]


class PacketBuffer:
    """Assembles packets from a byte stream that may be split anywhere."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Append received bytes and yield the packets that they complete.

        Args:
            data: Received bytes.

        Yields:
            Type and payload of each complete packet.

        Raises:
            ProtocolError: A packet's size is impossible.
        """
        self._bytes += data
        while len(self._bytes) >= _HEADER.size:
            size, kind = _HEADER.unpack_from(self._bytes)
            if size < _HEADER.size:
                message = f"an RTDE packet of size {size}: this is no RTDE server"
                raise ProtocolError(message, code="protocol.message_size")
            if len(self._bytes) < size:
                return
            payload = bytes(self._bytes[_HEADER.size : size])
            del self._bytes[:size]
            yield kind, payload


@dataclass(frozen=True)
class RtdeSample:
    """One data packet.

    Attributes:
        received: When its last byte arrived, for `RtdeReader.arrived`, or was read, for `RtdeReader.read` [s]; a value
            of `time.monotonic()`.
        values: Value of each output by its name.
    """

    received: float
    values: dict[str, Value]


class RtdeReader:
    """A connection to an RTDE server; not thread-safe.

    Args:
        sock: Connected socket, which the reader closes.
    """

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._buffer = PacketBuffer()
        self._packets: deque[tuple[float, int, bytes]] = deque()
        self._layout: list[tuple[str, int]] = []
        self._struct = struct.Struct(">")
        self._recipe = -1

    @classmethod
    def connect(cls, host: str, deadline: float, port: int = RTDE_PORT) -> Self:
        """Connect and negotiate protocol version 2.

        Args:
            host: Address of the controller.
            deadline: Deadline [s], a value of `time.monotonic()`.
            port: The RTDE server's port.

        Returns:
            The connected reader.

        Raises:
            NoAnswerError: The server does not answer in time.
            ProtocolError: The peer is no RTDE server, or refuses the version.
        """
        reader = cls(connect(host, port, deadline))
        try:
            reader.negotiate(deadline)
        except BaseException:
            reader.close()
            raise
        return reader

    def fileno(self) -> int:
        """The connection's file descriptor."""
        return self._sock.fileno()

    def negotiate(self, deadline: float) -> None:
        """Request protocol version 2; must be the first request.

        Args:
            deadline: Deadline [s], a value of `time.monotonic()`.

        Raises:
            ProtocolError: The controller refuses the version.
        """
        if self._request(_PROTOCOL, struct.pack(">H", 2), deadline, "B") != (1,):
            message = "the controller refuses RTDE protocol version 2: update PolyScope (3.4 or newer)"
            raise ProtocolError(message, code="protocol.rtde_version")

    def version(self, deadline: float) -> tuple[int, int, int, int]:
        """Version of URControl: major, minor, bugfix, build."""
        major, minor, bugfix, build = self._request(_VERSION, b"", deadline, "4I")
        return int(major), int(minor), int(bugfix), int(build)

    def subscribe(self, names: Sequence[str], rate: float, deadline: float) -> list[str]:
        """Subscribe to outputs and start them.

        Args:
            names: Names of the outputs.
            rate: Rate of the data packets [Hz].
            deadline: Deadline [s], a value of `time.monotonic()`.

        Returns:
            Names that this controller does not know. If there are any, nothing was started and the connection must be
            closed.

        Raises:
            NoAnswerError: The server does not answer in time.
            ProtocolError: The reply is malformed, or the server refuses to start.
        """
        payload = struct.pack(">d", rate) + ",".join(names).encode() + b","
        reply = self._reply(_OUTPUTS, payload, deadline)
        types = _ascii(reply[1:]).rstrip(",").split(",") if reply else []
        if len(types) != len(names):
            message = f"{len(names)} RTDE outputs requested, the reply has {len(types)} types"
            raise ProtocolError(message, code="protocol.rtde_reply")
        unknown = [name for name, kind in zip(names, types, strict=True) if kind == NOT_FOUND]
        if unknown:
            return unknown
        odd = [kind for kind in types if kind not in _FORMATS]
        if odd:
            message = f"RTDE type {odd[0][:40]!r} is unknown: update toolee_robot"
            raise ProtocolError(message, code="protocol.rtde_type")
        self._recipe = reply[0]
        formats = [_FORMATS[kind] for kind in types]
        self._layout = [(name, int(f[:-1] or 1)) for name, f in zip(names, formats, strict=True)]
        self._struct = struct.Struct(">" + "".join(formats))
        if self._request(_START, b"", deadline, "B") != (1,):
            message = "the controller refuses to start RTDE: too many RTDE clients may be connected"
            raise ProtocolError(message, code="protocol.rtde_refused")
        return []

    def read(self, deadline: float) -> RtdeSample:
        """Wait for the next data packet; text messages are skipped.

        Raises:
            NoAnswerError: None arrives by `deadline` [s], a value of `time.monotonic()`.
            ProtocolError: The server sends anything else.
        """
        while True:
            sample = self._sample(*self._packet(deadline))
            if sample is not None:
                return sample

    def arrived(self) -> list[RtdeSample]:
        """The data packets that have arrived, the oldest first; never waits.

        Raises:
            NoAnswerError: The connection is broken or closed.
            ProtocolError: The server sends anything but data and text.
        """
        self._fill(*receive_now(self._sock))
        samples = [self._sample(*packet) for packet in self._packets]
        self._packets.clear()
        return [sample for sample in samples if sample is not None]

    def close(self) -> None:
        """Close the connection."""
        self._sock.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _sample(self, received: float, kind: int, payload: bytes) -> RtdeSample | None:
        """Decode a packet; None for a text message."""
        if kind == _TEXT:
            return None
        if kind != _DATA or len(payload) != 1 + self._struct.size or payload[0] != self._recipe:
            raise ProtocolError(
                f"an RTDE packet of type {kind} with {len(payload)} bytes, expected data with {1 + self._struct.size}",
                code="protocol.rtde_packet",
            )
        return RtdeSample(received, self._unpack(payload[1:]))

    def _unpack(self, data: bytes) -> dict[str, Value]:
        flat, values, at = self._struct.unpack(data), {}, 0
        for name, count in self._layout:
            values[name] = flat[at] if count == 1 else tuple(flat[at : at + count])
            at += count
        return values

    def _request(self, kind: int, payload: bytes, deadline: float, layout: str) -> tuple[int, ...]:
        reply = self._reply(kind, payload, deadline)
        if len(reply) != struct.calcsize(">" + layout):
            message = f"the RTDE reply of type {chr(kind)!r} has {len(reply)} bytes: this is no RTDE server"
            raise ProtocolError(message, code="protocol.rtde_reply")
        return struct.unpack(">" + layout, reply)

    def _reply(self, kind: int, payload: bytes, deadline: float) -> bytes:
        send(self._sock, _HEADER.pack(_HEADER.size + len(payload), kind) + payload, deadline)
        while True:
            _, answered, reply = self._packet(deadline)
            if answered == _TEXT:
                continue
            if answered != kind:
                raise ProtocolError(f"the RTDE reply has type {answered}, expected {kind}", code="protocol.rtde_reply")
            return reply

    def _packet(self, deadline: float) -> tuple[float, int, bytes]:
        while not self._packets:
            self._fill(receive(self._sock, deadline), time.monotonic())
        if time.monotonic() > deadline:  # bounds a flood of skipped packets as well
            message = "the RTDE server sends data, but not the requested data in time"
            raise NoAnswerError(message, code="no_answer.timeout")
        return self._packets.popleft()

    def _fill(self, data: bytes, received: float) -> None:
        self._packets.extend((received, kind, payload) for kind, payload in self._buffer.feed(data))


def _ascii(data: bytes) -> str:
    try:
        return data.decode("ascii")
    except UnicodeDecodeError as error:
        raise ProtocolError("an RTDE reply is not text, expected names of types", code="protocol.not_text") from error
