"""Modbus-TCP as bytes: requests are built, replies are found among whatever else arrives.

A frame is `TRANSACTION(2) 00 00 LENGTH(2) UNIT FUNCTION ...`, numbers big-endian; LENGTH counts from UNIT on (MODBUS
Messaging on TCP/IP Implementation Guide V1.0b, section 3.1.3). Functions 03, 06 and 16 and their exceptions are those
of the MODBUS Application Protocol V1.1b3, sections 6.3, 6.6, 6.12 and 7.

As on RS-485, everything of a reply but its data is known from the request, so it is looked for, not parsed. Modbus-TCP
has no checksum of its own: a wrong byte in the data is for TCP's checksum to see.

pymodbus's client is not used: it gives a request that it repeats the same transaction identifier, so that a late reply
passes for a new one; it connects again by itself, so that an unplug passes unnoticed; and it refuses the shifted
identifiers of which `modbus_line` tells. The tests have pymodbus at the other end of both driver and emulator.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from toolee_robot.devices.hands.inspire.frames import WRITTEN

READ, WRITE_ONE, WRITE = 0x03, 0x06, 0x10
"""Read holding registers; write a single one; write multiple ones."""
UNITS = range(1, 255)
MOST_READ, MOST_WRITTEN = 125, 123
"""Registers in one request."""
_EXCEPTION = 0x80
_REFUSALS = (1, 2, 3)
"""Exceptions that asking again does not change: illegal function, address, value. The others tell of a hand that is
busy, or of a gateway before it."""
_KEPT = 4096


@dataclass(frozen=True)
class Request:
    """A request to one hand, and what its reply looks like."""

    transaction: int
    """Its transaction identifier, 16 bits."""
    unit: int
    """The hand's unit identifier."""
    function: int
    """READ, WRITE_ONE or WRITE."""
    register: int
    """Address of the first register."""
    count: int
    """Number of registers."""
    data: bytes = b""
    """What is written; none of a READ."""

    def __post_init__(self) -> None:
        if self.unit not in UNITS or not 0 <= self.register <= 0xFFFF:
            raise ValueError(f"no such hand or register: {self.unit}, {self.register}")
        most = MOST_READ if self.function == READ else MOST_WRITTEN
        if not 1 <= self.count <= most:
            raise ValueError(f"1 to {most} registers of two bytes can be read or written at once")

    @property
    def encoded(self) -> bytes:
        """The bytes to send."""
        if self.function == WRITE_ONE:
            return self._frame(self.transaction, struct.pack(">BH", WRITE_ONE, self.register) + self.data)
        body = struct.pack(">BHH", self.function, self.register, self.count)
        if self.function == WRITE:
            body += bytes((len(self.data),)) + self.data
        return self._frame(self.transaction, body)

    @property
    def reply_length(self) -> int:
        """Number of bytes of the reply after `reply_head`."""
        return 2 * self.count if self.function == READ else 0

    def reply_head(self, shift: int) -> bytes:
        """The bytes with which the reply begins, up to its data.

        Args:
            shift: By how much the reply's transaction identifier is larger than the request's.
        """
        if self.function == READ:
            head = bytes((READ, self.reply_length))
        elif self.function == WRITE_ONE:
            head = struct.pack(">BH", WRITE_ONE, self.register) + self.data
        else:
            head = struct.pack(">BHH", WRITE, self.register, self.count)
        return self._frame(self.transaction + shift, head, self.reply_length)

    def exception_head(self, shift: int) -> bytes:
        """The bytes with which an exception begins, up to its code; `shift` as of `reply_head`."""
        return self._frame(self.transaction + shift, bytes((self.function | _EXCEPTION,)), 1)

    def _frame(self, transaction: int, body: bytes, further: int = 0) -> bytes:
        return struct.pack(">HHHB", transaction & 0xFFFF, 0, 1 + len(body) + further, self.unit) + body


def read_request(transaction: int, unit: int, register: int, size: int) -> Request:
    """Build a request for bytes from a register on.

    Args:
        transaction: Its transaction identifier.
        unit: The hand's unit identifier.
        register: Address of the first register.
        size: Number of bytes, two for each register.

    Returns:
        The request.

    Raises:
        ValueError: A number is out of range, or no whole number of registers.
    """
    return Request(transaction, unit, READ, register, _registers(size))


def write_request(transaction: int, unit: int, register: int, data: bytes) -> Request:
    """Build a request that writes bytes from a register on.

    Args:
        transaction: Its transaction identifier.
        unit: The hand's unit identifier.
        register: Address of the first register.
        data: The bytes, two for each register.

    Returns:
        The request.

    Raises:
        ValueError: A number is out of range, or no whole number of registers.
    """
    count = _registers(len(data))
    return Request(transaction, unit, WRITE_ONE if count == 1 else WRITE, register, count, data)


def _registers(size: int) -> int:
    if size % 2:
        raise ValueError(f"{size} bytes are no whole number of registers")
    return size // 2


@dataclass
class ReplySearch:
    """Looks for the reply to one request in the bytes that arrive.

    Attributes:
        request: What was asked.
        shifts: By how much the reply's transaction identifier may be larger than the request's.
        shift: By how much it was.
        exception: Code of the exception that came instead; None for none.
        corrupt: Number of replies to it that were found damaged.
    """

    request: Request
    shifts: tuple[int, ...] = (0,)
    shift: int = 0
    exception: int | None = None
    corrupt: int = 0
    _received: bytearray = field(default_factory=bytearray)
    _from: int = 0

    @property
    def refusal(self) -> str:
        """What the hand refuses for good, for people; empty if nothing."""
        if self.exception not in _REFUSALS:
            return ""
        return f"function {self.request.function} at register {self.request.register} (exception {self.exception})"

    @property
    def over(self) -> bool:
        """Whether no other reply will come: the hand sends one, and it was an exception, or damaged."""
        return self.exception is not None or self.corrupt > 0

    def feed(self, data: bytes) -> bytes | None:
        """Take further bytes.

        Args:
            data: Bytes as they came.

        Returns:
            What was read, or WRITTEN; None while there is no whole, undamaged reply, and for an exception.
        """
        self._received += data
        while (found := self._first()) is not None:
            begin, shift, head, length = found
            end = begin + len(head) + length
            if len(self._received) < end:
                return None
            self._from = begin + 1
            if self._whole(begin, end, head):
                self.shift, payload = shift, bytes(self._received[begin + len(head) : end])
                if head == self.request.exception_head(shift):
                    self.exception = payload[0]
                    return None
                return payload or WRITTEN
            self.corrupt += 1
        if len(self._received) > _KEPT:  # somebody talks without end
            del self._received[:-_KEPT]
            self._from = 0
        return None

    def _first(self) -> tuple[int, int, bytes, int] | None:
        """Where a reply begins, with its shift, its head, and the number of bytes after that."""
        found = [
            (begin, shift, head, length)
            for shift in self.shifts
            for head, length in (
                (self.request.reply_head(shift), self.request.reply_length),
                (self.request.exception_head(shift), 1),
            )
            if (begin := self._received.find(head, self._from)) >= 0
        ]
        return min(found, default=None)

    def _whole(self, begin: int, end: int, head: bytes) -> bool:
        """Whether the frame ends there: TCP keeps the order, so that only its own copy can follow it.

        What lacks bytes, or has some too many, does not end there; nor does one within which another begins.
        """
        return (
            head.startswith(bytes(self._received[end : end + len(head)]))
            and self._received.find(head, begin + 1, end) < 0
        )
