"""The hand's side of RS-485: requests out of a stream of bytes, and the frames of replies."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto

from toolee_robot.sim_backend.hand_wire import Frame
from toolee_robot.sim_backend.inspire_hand.hand import CALIBRATE, SAVE, Hand

_SECOND_FRAME = {SAVE: 1.0, CALIBRATE: 6.0}
"""Register -> time until a write of it is answered again [s]."""


@dataclass(frozen=True)
class ReadRequest:
    """Somebody reads registers."""

    address: int
    """Address of the first byte."""
    count: int
    """Number of bytes."""


@dataclass(frozen=True)
class WriteRequest:
    """Somebody writes registers."""

    address: int
    """Address of the first byte."""
    data: bytes
    """The bytes."""


class _Wait(Enum):
    FIRST, SECOND, NUMBER, LENGTH, BODY = auto(), auto(), auto(), auto(), auto()


@dataclass
class RequestParser:
    """Takes the bytes of the line one by one, as a hand's firmware would.

    Attributes:
        number: The hand's own number.
        ignored: Number of frames that were damaged, or for another hand.
    """

    number: int
    ignored: int = 0
    _state: _Wait = _Wait.FIRST
    _sum: int = 0
    _for: int = 0
    _missing: int = 0
    _body: bytearray = field(default_factory=bytearray)

    def take(self, data: bytes) -> list[ReadRequest | WriteRequest]:
        """Take bytes.

        Args:
            data: As they came over the line.

        Returns:
            The requests to this hand that they complete.
        """
        return [request for byte in data if (request := self._byte(byte)) is not None]

    def _byte(self, byte: int) -> ReadRequest | WriteRequest | None:
        if self._state is _Wait.FIRST:
            self._state = _Wait.SECOND if byte == 0xEB else _Wait.FIRST
        elif self._state is _Wait.SECOND:
            self._state = _Wait.NUMBER if byte == 0x90 else _Wait.SECOND if byte == 0xEB else _Wait.FIRST
        elif self._state is _Wait.NUMBER:
            self._for, self._sum, self._state = byte, byte, _Wait.LENGTH
        elif self._state is _Wait.LENGTH:
            self._sum += byte
            self._missing, self._body = byte + 1, bytearray()
            self._state = _Wait.BODY if byte >= 4 else _Wait.FIRST
        else:
            self._body.append(byte)
            self._missing -= 1
            if self._missing == 0:
                self._state = _Wait.FIRST
                return self._request()
        return None

    def _request(self) -> ReadRequest | WriteRequest | None:
        *body, received = self._body
        command, low, high, *data = body
        address = low + 256 * high
        if (self._sum + sum(body)) % 256 == received and self._for == self.number:
            if command == 0x11 and len(data) == 1:
                return ReadRequest(address, data[0])
            if command == 0x12:
                return WriteRequest(address, bytes(data))
        self.ignored += 1
        return None


def answer(hand: Hand, request: ReadRequest | WriteRequest) -> list[Frame]:
    """Carry out a request.

    Args:
        hand: The hand that it is for.
        request: The request.

    Returns:
        The frames that answer it.
    """
    if isinstance(request, ReadRequest):
        data = hand.read(request.address, request.count)
        return [Frame(reply(hand.number, 0x11, request.address, data))]
    done = hand.write(request.address, request.data)
    result = Frame(reply(hand.number, 0x12, request.address, bytes([done])))
    later = _SECOND_FRAME.get(request.address) if done else None
    return [result] if later is None else [result, Frame(result.data, later)]


def reply(number: int, command: int, address: int, data: bytes) -> bytes:
    """Build a reply.

    Args:
        number: The hand's number.
        command: That of the request.
        address: That of the request.
        data: What was read, or the result of a write.

    Returns:
        The frame.
    """
    after_header = [number, len(data) + 3, command, address % 256, address // 256, *data]
    return bytes([0x90, 0xEB, *after_header, sum(after_header) % 256])


def foreign(frame: bytes) -> bytes:
    """Make the reply of another hand out of one.

    Args:
        frame: A reply.

    Returns:
        The same of the hand with the next number.
    """
    other = [frame[2] % 254 + 1, *frame[3:-1]]
    return bytes([*frame[:2], *other, sum(other) % 256])
