"""The hand's side of Modbus-TCP: requests out of a stream of bytes, carried out, and the frames of replies.

After the MODBUS Application Protocol V1.1b3 and the MODBUS Messaging on TCP/IP Implementation Guide V1.0b.
"""

from __future__ import annotations

from collections import deque
from functools import partial

from toolee_robot.sim_backend.hand_wire import LineFaults
from toolee_robot.sim_backend.inspire_hand.hand import CALIBRATE, CLEAR, IDENTIFIER, SAVE, WORDS, Hand

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
"""Exception codes."""
FRAMING = 9
"""Bytes of a reply before the data that was read."""
_WRITES = (6, 16)
_CONTROLS = (IDENTIFIER, CLEAR, SAVE, CALIBRATE)
_REGISTERS = range(1000, 5124)
_LONGEST = 254


class ModbusServer:
    """Answers the requests of one connection.

    Args:
        hand: The hand.
        faults: Faults of its line; None for none.

    Attributes:
        shift: By how much the transaction identifier of a reply is larger than that of the request.
        refusals: Codes of the exceptions that answer the next requests, which are not carried out.
        ignored: Number of frames that were for another hand, or no Modbus.
    """

    def __init__(self, hand: Hand, faults: LineFaults | None = None) -> None:
        self._hand, self._faults = hand, faults or LineFaults(foreign)
        self._stream = bytearray()
        self.shift = 0
        self.refusals: deque[int] = deque()
        self.ignored = 0

    def reset(self) -> None:
        """Begin a connection."""
        self._stream.clear()

    def take(self, data: bytes) -> list[bytes]:
        """Take bytes.

        Args:
            data: As they came.

        Returns:
            The replies to the requests that they complete.
        """
        self._stream += data
        replies = []
        while len(self._stream) >= 6:
            transaction, protocol, length = (_word(self._stream, i) for i in (0, 2, 4))
            if protocol or not 2 <= length <= _LONGEST:  # where the next frame begins, nobody knows
                self.ignored += 1
                self._stream.clear()
                break
            if len(self._stream) < 6 + length:
                break
            unit, *body = self._stream[6 : 6 + length]
            del self._stream[: 6 + length]
            if unit != self._hand.number:
                self.ignored += 1
                continue
            carry_out = partial(self._reply, transaction, bytes(body))
            replies += self._faults.write(carry_out) if body[0] in _WRITES else carry_out()
        return replies

    def _reply(self, transaction: int, body: bytes) -> list[bytes]:
        unit, answer = self._hand.number, self._answer(body)
        return [bytes([*_split(transaction + self.shift), 0, 0, *_split(1 + len(answer)), unit, *answer])]

    def _answer(self, body: bytes) -> bytes:
        function, rest = body[0], body[1:]
        if self.refusals:
            return bytes([function | 0x80, self.refusals.popleft()])
        carry_out = {3: self._read, 6: self._write_one, 16: self._write}.get(function)
        if carry_out is None:
            return bytes([function | 0x80, ILLEGAL_FUNCTION])
        answer = carry_out(rest) if len(rest) >= 4 else ILLEGAL_VALUE
        return bytes([function | 0x80, answer]) if isinstance(answer, int) else bytes([function]) + answer

    def _read(self, rest: bytes) -> bytes | int:
        address, count = _word(rest, 0), _word(rest, 2)
        if len(rest) != 4 or not 1 <= count <= 125:
            return ILLEGAL_VALUE
        if not (address in _REGISTERS and address + 2 * count - 1 in _REGISTERS):
            return ILLEGAL_ADDRESS
        data = self._hand.read(address & ~1, 2 * count + 2)
        swapped = bytearray(data)
        for first in WORDS:
            for i in range(max(0, first - (address & ~1)), min(len(data), first + 12 - (address & ~1)), 2):
                swapped[i], swapped[i + 1] = data[i + 1], data[i]
        skipped = address & 1
        return bytes([2 * count, *swapped[skipped : skipped + 2 * count]])

    def _write_one(self, rest: bytes) -> bytes | int:
        if len(rest) != 4:
            return ILLEGAL_VALUE
        refused = self._put(_word(rest, 0), rest[2:])
        return rest if refused is None else refused

    def _write(self, rest: bytes) -> bytes | int:
        count, data = _word(rest, 2), rest[5:]
        if not 1 <= count <= 123 or len(rest) < 5 or not rest[4] == 2 * count == len(data):
            return ILLEGAL_VALUE
        refused = self._put(_word(rest, 0), data)
        return rest[:4] if refused is None else refused

    def _put(self, address: int, data: bytes) -> int | None:
        """Write registers; the exception if they cannot be written."""
        if address in _CONTROLS:
            written = len(data) == 2 and self._hand.write(address, bytes([data[1]])) and data[0] == 0
            return None if written else ILLEGAL_VALUE
        swapped = b"".join(bytes([data[i + 1], data[i]]) for i in range(0, len(data), 2))
        return None if self._hand.write(address, swapped) else ILLEGAL_ADDRESS


def foreign(frame: bytes) -> bytes:
    """Make the reply to another transaction out of one, with other data.

    Args:
        frame: A reply.

    Returns:
        What would be taken for it if only the transaction identifier were not looked at.
    """
    return bytes([frame[0] ^ 0x40, *frame[1:FRAMING], *(value ^ 1 for value in frame[FRAMING:])])


def _word(data: bytes | bytearray, at: int) -> int:
    return 256 * data[at] + data[at + 1]


def _split(value: int) -> tuple[int, int]:
    return value // 256 % 256, value % 256
