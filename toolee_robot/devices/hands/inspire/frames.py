"""The maker's frames as bytes: requests are built, replies are found among whatever else arrives.

A request is `EB 90 ID LEN CMD REGISTER(2) PAYLOAD CHECKSUM`, a reply begins with `90 EB` instead. LEN counts command,
register and payload; the checksum is the low byte of the sum of all bytes after the header; numbers are little-endian.

Everything of a reply but its payload and its checksum is known from the request. So a reply is not parsed, it is looked
for: garbage, replies to other requests, of other hands, and the request's own echo do not match, and no corrupted
length makes anybody wait for bytes that never come. What the checksum, an 8-bit sum, cannot see is a change of several
bytes that cancel out.
"""

from __future__ import annotations

from dataclasses import dataclass, field

REQUEST_HEADER, REPLY_HEADER = b"\xeb\x90", b"\x90\xeb"
READ, WRITE = 0x11, 0x12
WRITTEN = b"\x01"
"""Payload of the reply to a write that was carried out."""
HAND_IDS = range(1, 255)
MAX_PAYLOAD = 252
"""Bytes: LEN is one byte, and counts three more."""
_KEPT = 4096


def checksum(body: bytes) -> int:
    """The low byte of the sum of all bytes after the header."""
    return sum(body) & 0xFF


@dataclass(frozen=True)
class Request:
    """A request to one hand, and what its reply looks like."""

    hand_id: int
    """The hand's number on the line, 1 to 254."""
    command: int
    """READ or WRITE."""
    register: int
    """Address of the first byte."""
    payload: bytes
    """Of READ one byte, the number of bytes to read; of WRITE the bytes to write."""

    def __post_init__(self) -> None:
        if self.hand_id not in HAND_IDS or not 0 <= self.register <= 0xFFFF:
            raise ValueError(f"no such hand or register: {self.hand_id}, {self.register}")
        if not 1 <= len(self.payload) <= MAX_PAYLOAD or not 1 <= self.reply_length <= MAX_PAYLOAD:
            raise ValueError(f"1 to {MAX_PAYLOAD} bytes can be read or written at once")

    @property
    def encoded(self) -> bytes:
        """The bytes to send."""
        body = bytes((self.hand_id, 3 + len(self.payload), self.command, *self._register)) + self.payload
        return REQUEST_HEADER + body + bytes((checksum(body),))

    @property
    def reply_length(self) -> int:
        """Number of bytes of the reply's payload."""
        return self.payload[0] if self.command == READ else len(WRITTEN)

    @property
    def reply_prefix(self) -> bytes:
        """The bytes with which the reply begins, up to its payload."""
        return REPLY_HEADER + bytes((self.hand_id, 3 + self.reply_length, self.command, *self._register))

    @property
    def _register(self) -> bytes:
        return self.register.to_bytes(2, "little")


def read_request(hand_id: int, register: int, count: int) -> Request:
    """Build a request for `count` bytes from a register on.

    Args:
        hand_id: The hand's number on the line.
        register: Address of the first byte.
        count: Number of bytes.

    Returns:
        The request.

    Raises:
        ValueError: A number is out of range.
    """
    return Request(hand_id, READ, register, bytes((count,)))


def write_request(hand_id: int, register: int, data: bytes) -> Request:
    """Build a request that writes bytes from a register on.

    Args:
        hand_id: The hand's number on the line.
        register: Address of the first byte.
        data: The bytes.

    Returns:
        The request.

    Raises:
        ValueError: A number is out of range, or there are too many bytes.
    """
    return Request(hand_id, WRITE, register, data)


@dataclass
class ReplySearch:
    """Looks for the reply to one request in the bytes that arrive.

    Attributes:
        request: What was asked.
        corrupt: Number of replies to it that were found damaged.
    """

    request: Request
    corrupt: int = 0
    refusal = ""
    _received: bytearray = field(default_factory=bytearray)
    _from: int = 0

    def feed(self, data: bytes) -> bytes | None:
        """Take further bytes.

        Args:
            data: Bytes as they came.

        Returns:
            The payload of the reply; None while there is no whole, undamaged one.
        """
        self._received += data
        prefix, length = self.request.reply_prefix, self.request.reply_length
        while (begin := self._received.find(prefix, self._from)) >= 0:
            end = begin + len(prefix) + length
            if len(self._received) <= end:
                self._from = begin
                return None
            if self._whole(begin, end):
                return bytes(self._received[begin + len(prefix) : end])
            self.corrupt += 1
            self._from = begin + 1
        self._from = max(self._from, len(self._received) - len(prefix) + 1)
        if len(self._received) > _KEPT:  # somebody talks without end
            del self._received[: self._from]
            self._from = 0
        return None

    @property
    def over(self) -> bool:
        """Whether no other reply will come: the hand sends one, and it was damaged."""
        return self.corrupt > 0

    @property
    def seen(self) -> bytes:
        """Everything that came, for messages."""
        return bytes(self._received)

    def _whole(self, begin: int, end: int) -> bool:
        """Whether the checksum is right and the frame ends there.

        A byte too many shifts the checksum, and one in 256 such frames has the right one by chance.
        """
        body = bytes(self._received[begin + len(REPLY_HEADER) : end])
        rest = self._received[end + 1 : end + 1 + len(REPLY_HEADER)]
        return self._received[end] == checksum(body) and REPLY_HEADER.startswith(bytes(rest))
