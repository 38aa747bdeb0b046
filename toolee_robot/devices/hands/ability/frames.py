"""The bytes of the extended API: commands are built, replies are found in what arrives.

A command is `ADDRESS HEADER PAYLOAD CHECKSUM`, a reply `HEADER PAYLOAD LIMITED CHECKSUM`; the sum of all bytes is 0
modulo 256 (ICD 3.4.8). Both are put between two flag bytes; a flag or an escape byte inside is escaped (ICD 3.5.5). A
reply says neither of which hand it is, nor to which command: only its header, which is that of the command, tells.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import IntEnum

FLAG, ESCAPE, MASK = 0x7E, 0x7D, 0x20
MOTORS = 6
POSITION_UNIT = 150.0 / 32767.0
"""Degrees of a position's count (ICD 3.4.1)."""
ADDRESSES = range(1, 256)
"""Addresses that a hand may have; 0x50 as delivered (ICD 3.1.2.1)."""
_LONGEST = 256


class Header(IntEnum):
    """Headers of the commands in use: the low digit is the variant of the reply."""

    POSITION_CURRENT = 0x10
    """Positions to go to; the reply has positions, currents and touch."""
    POSITION_VELOCITY = 0x11
    """Positions to go to; the reply has positions, velocities and touch."""
    READ_CURRENT = 0xA0
    """Changes nothing, and does not enter the API mode; the reply is as of POSITION_CURRENT."""
    READ_VELOCITY = 0xA1
    """Changes nothing; the reply is as of POSITION_VELOCITY."""


REPLY_LENGTH = 72
"""Bytes of the replies to those, before stuffing."""


def checksum(data: bytes) -> int:
    """The byte that makes the sum of all bytes 0 modulo 256."""
    return -sum(data) & 0xFF


def stuff(data: bytes) -> bytes:
    """Put a frame between flags, and escape what looks like one in it.

    Args:
        data: The frame's bytes.

    Returns:
        The bytes for the line.
    """
    escaped = data.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e")
    return b"\x7e" + escaped + b"\x7e"


def position_command(address: int, header: Header, degrees: tuple[float, ...]) -> bytes:
    """Build a command that sends the motors to positions.

    Args:
        address: The hand's address.
        header: POSITION_CURRENT or POSITION_VELOCITY.
        degrees: Positions of the six motors in the maker's order [deg].

    Returns:
        The bytes for the line.

    Raises:
        ValueError: There is no such address, or a position is out of the range of its number.
    """
    counts = [round(angle / POSITION_UNIT) for angle in degrees]
    if len(counts) != MOTORS or max(map(abs, counts)) > 0x7FFF:
        raise ValueError(f"six positions within 150 deg, not {degrees}")
    return _command(address, header, struct.pack("<6h", *counts))


def read_command(address: int, header: Header) -> bytes:
    """Build a command that asks for a reply and changes nothing.

    Args:
        address: The hand's address.
        header: READ_CURRENT or READ_VELOCITY.

    Returns:
        The bytes for the line.

    Raises:
        ValueError: There is no such address.
    """
    return _command(address, header, b"")


def _command(address: int, header: Header, payload: bytes) -> bytes:
    if address not in ADDRESSES:
        raise ValueError(f"no hand has the address {address}")
    body = bytes((address, header)) + payload
    return stuff(body + bytes((checksum(body),)))


@dataclass
class FrameReader:
    """Takes the bytes of the line as they come, and finds the undamaged replies in them.

    A flag byte always ends a frame and begins the next, so whatever went wrong is over with the next flag.

    Attributes:
        corrupt: Number of frames of a reply's length whose checksum was wrong, or with an escape that none follows.
        foreign: Number of others: noise, pieces, echoes, replies of another length.
    """

    corrupt: int = 0
    foreign: int = 0
    _frame: bytearray = field(default_factory=bytearray)
    _escaped: bool = False
    _broken: bool = False

    def feed(self, data: bytes) -> list[bytes]:
        """Take further bytes.

        Args:
            data: Bytes as they came.

        Returns:
            The replies that they complete, without flags and escapes.
        """
        found = []
        for byte in data:
            if byte == FLAG:
                frame = self._end()
                if frame is not None:
                    found.append(frame)
            elif self._escaped:
                self._escaped = False
                # Only a flag and an escape are ever escaped.
                self._broken |= byte ^ MASK not in (FLAG, ESCAPE)
                self._frame.append(byte ^ MASK)
            elif byte == ESCAPE:
                self._escaped = True
            elif len(self._frame) < _LONGEST:
                self._frame.append(byte)
            else:
                self._broken = True
        return found

    def _end(self) -> bytes | None:
        frame, broken = bytes(self._frame), self._broken or self._escaped
        self._frame, self._escaped, self._broken = bytearray(), False, False
        if len(frame) != REPLY_LENGTH:
            self.foreign += bool(frame)
            return None
        if broken or sum(frame) & 0xFF:
            self.corrupt += 1
            return None
        return frame
