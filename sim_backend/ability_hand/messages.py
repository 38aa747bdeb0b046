"""The hand's side of the wire: messages out of a stream of bytes, and the frames of replies."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

_POSITION, _LONGEST = 32767.0 / 150.0, 64


@dataclass(frozen=True)
class Message:
    """A whole message to this hand."""

    header: int
    """Its format header."""
    values: tuple[int, ...]
    """Signed 16-bit numbers that follow, as many as there are."""


@dataclass
class MessageParser:
    """Takes the bytes of the line one by one, as a hand's firmware would that removes the stuffing.

    Attributes:
        address: The hand's own.
        ignored: Number of frames that were damaged, too long, or for another hand.
    """

    address: int
    ignored: int = 0
    _body: list[int] = field(default_factory=list)
    _mask: int = 0

    def take(self, data: bytes) -> list[Message]:
        """Take bytes.

        Args:
            data: As they came over the line.

        Returns:
            The messages to this hand that they complete.
        """
        messages = []
        for byte in data:
            if byte == 0x7E:
                message = self._message()
                self._body, self._mask = [], 0
                if message is not None:
                    messages.append(message)
            elif byte == 0x7D:
                self._mask = 0x20
            else:
                if len(self._body) <= _LONGEST:
                    self._body.append(byte ^ self._mask)
                self._mask = 0
        return messages

    def _message(self) -> Message | None:
        body = self._body
        if not body:
            return None
        if not 3 <= len(body) <= 15 or sum(body) % 256 or body[0] != self.address:
            self.ignored += 1
            return None
        payload = bytes(body[2:-1])
        count = len(payload) // 2
        return Message(body[1], struct.unpack(f"<{count}h", payload[: 2 * count]))


def stuffed(frame: bytes) -> bytes:
    """Add the sum that makes it zero, the flags, and the escapes.

    Args:
        frame: A reply, without its sum.

    Returns:
        What goes over the line.
    """
    line = [0x7E]
    for byte in (*frame, (256 - sum(frame) % 256) % 256):
        line += [0x7D, byte ^ 0x20] if byte in (0x7D, 0x7E) else [byte]
    return bytes([*line, 0x7E])


def reply(
    header: int,
    degrees: Sequence[float],
    currents: Sequence[int],
    velocities: Sequence[int],
    pads: Sequence[int],
    limited: int,
) -> bytes:
    """Build a reply of the variant that its header asks for.

    Args:
        header: Header of the command.
        degrees: Positions of the six motors [deg].
        currents: Their currents in the hand's unit.
        velocities: Their rotors' velocities [1/4 rad/s].
        pads: The 30 touch pads [counts].
        limited: A bit for each motor that protects itself.

    Returns:
        The frame, stuffed.
    """
    variant = header & 0x0F
    positions = [max(-32767, min(32767, round(angle * _POSITION))) for angle in degrees]
    seconds = velocities if variant == 1 else currents
    frame = bytes([header]) + b"".join(struct.pack("<hh", *pair) for pair in zip(positions, seconds, strict=True))
    if variant == 2:
        frame += struct.pack("<6h", *velocities)
    else:
        for low, high in zip(pads[::2], pads[1::2], strict=True):
            frame += bytes([low % 256, low // 256 + high % 16 * 16, high // 16])
    return stuffed(frame + bytes([limited]))


def foreign(frame: bytes) -> bytes:
    """Make a reply to somebody else's command out of one: to one for voltages.

    Args:
        frame: A reply as it goes over the line.

    Returns:
        Another one.
    """
    body = bytearray(frame[1:-1].replace(b"\x7d\x5e", b"\x7e").replace(b"\x7d\x5d", b"\x7d"))
    body[0] = 0x40 | body[0] & 0x0F
    return stuffed(bytes(body[:-1]))
