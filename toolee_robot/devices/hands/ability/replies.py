"""What the hand says in a reply."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntFlag

from toolee_robot.devices.hands.ability.frames import POSITION_UNIT, REPLY_LENGTH, Header
from toolee_robot.errors import ProtocolError

POSITIONS_FROM, POSITIONS_TO = (-20.0,) * 5 + (-140.0,), (140.0,) * 5 + (20.0,)
"""Positions beyond which no hand is, in the maker's order [deg]: 0 to 100, and 0 to -100 for the rotator, with room for
a finger that gives way."""
_WORDS = struct.Struct("<12h")


class Limited(IntFlag):
    """Motors that do not do what they are told, to protect themselves (ICD 3.4.7): after a collision, or of heat.

    The hand does not say which of the two.
    """

    INDEX = 1
    MIDDLE = 2
    RING = 4
    LITTLE = 8
    THUMB_FLEXOR = 16
    THUMB_ROTATOR = 32


@dataclass(frozen=True)
class Reply:
    """A reply with positions, currents or velocities, and touch."""

    header: Header
    """Of the command that it answers."""
    positions: tuple[float, ...]
    """Of the six motors [deg]."""
    seconds: tuple[int, ...]
    """Currents in the hand's own unit, or rotor velocities in 1/4 rad/s, of the six motors."""
    touch: tuple[int, ...]
    """The 30 pads, six of each finger [counts of 0 to 4095]."""
    limited: Limited
    """Motors that protect themselves."""


def decode(frame: bytes) -> Reply | None:
    """Decode a reply.

    Args:
        frame: An undamaged frame.

    Returns:
        What it says; None for one that answers none of the commands in use.

    Raises:
        ProtocolError: It says what no Ability Hand says.
    """
    if len(frame) != REPLY_LENGTH or frame[0] not in {*Header}:
        return None
    words = _WORDS.unpack_from(frame, 1)
    positions = tuple(count * POSITION_UNIT for count in words[::2])
    limits = zip(POSITIONS_FROM, positions, POSITIONS_TO, strict=True)
    if not all(low <= position <= high for low, position, high in limits):
        angles = ", ".join(f"{position:.0f}" for position in positions)
        message = f"the hand says that its motors are at {angles} deg: is it an Ability Hand?"
        raise ProtocolError(message, code="protocol.hand_values")
    bits = int.from_bytes(frame[25:70], "little")  # 12 bits a pad, the first in the lowest bits
    touch = tuple(bits >> 12 * pad & 0xFFF for pad in range(30))
    return Reply(Header(frame[0]), positions, words[1::2], touch, Limited(frame[70] & 0x3F))
