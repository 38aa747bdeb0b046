"""The register map of the RH56, as far as it is used, and what the hand says in it.

Every block has one entry for each of the six motors: little, ring, middle, index, thumb bend, thumb rotation. Angles
are in counts of 0 (bent, the thumb across the palm) to 1000 (stretched, the thumb aside); forces in counts that the
manual calls grams.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from toolee_robot.errors import DeviceError, ProtocolError
from toolee_robot.robots.hands.inspire import COUNTS, MOTORS

CLEAR_ERROR, ANGLE_SET, FORCE_SET, SPEED_SET = 1004, 1486, 1498, 1522
ANGLE_ACT, FORCE_ACT, CURRENT, ERROR, STATUS, TEMPERATURE = 1546, 1582, 1594, 1606, 1612, 1618
"""Addresses of the first byte. The register of the baud rate is not here: sources disagree on it, so it is never
written."""
ANGLES_LENGTH, CONDITION_LENGTH = 12, 42
"""Bytes of ANGLE_ACT, and from FORCE_ACT to the end of TEMPERATURE, which lie next to each other."""
FULL = COUNTS
"""Counts of the whole range of an angle, a speed, and a force threshold."""
_WORST_TEMPERATURE = 150
_CONDITION = "6h6H6B6B6B"


class Fault(IntFlag):
    """Bits of a motor's ERROR register."""

    STALL = 1
    OVER_TEMPERATURE = 2
    OVER_CURRENT = 4
    MOTOR = 8
    COMMUNICATION = 16


class Status(IntEnum):
    """Values of a motor's STATUS register."""

    RELEASING = 0
    GRASPING = 1
    POSITION_REACHED = 2
    FORCE_REACHED = 3
    OVER_CURRENT = 5
    STALLED = 6
    FAILED = 7
    NEVER_COMMANDED = 255


FAULT_CODES = {
    Fault.STALL: ("device.hand_stall", "stalled", "look what blocks it"),
    Fault.OVER_TEMPERATURE: ("device.hand_over_temperature", "too hot", "let it cool down"),
    Fault.OVER_CURRENT: ("device.hand_over_current", "over current", "look what blocks it"),
    Fault.MOTOR: ("device.hand_motor", "motor failure", "have the hand repaired"),
    Fault.COMMUNICATION: ("device.hand_communication", "internal communication failure", "restart the hand"),
}
"""Fault -> code of the error, description, remedy."""


@dataclass(frozen=True)
class Condition:
    """Forces, currents, faults, states and temperatures of the six motors."""

    forces: tuple[int, ...]
    """Forces [counts]; negative where the finger is pulled."""
    currents: tuple[int, ...]
    """Motor currents [mA]."""
    faults: tuple[Fault, ...]
    """What is wrong with each."""
    statuses: tuple[Status, ...]
    """What each is doing."""
    temperatures: tuple[int, ...]
    """Temperatures [deg C]."""

    @property
    def described(self) -> str:
        """The faults in words; empty for none."""
        found = [
            f"{motor}: {FAULT_CODES[bit][1]}"
            for motor, faults in zip(MOTORS, self.faults, strict=True)
            for bit in FAULT_CODES
            if bit in faults
        ]
        return ", ".join(found)

    @property
    def worst(self) -> Fault | None:
        """The fault that decides what is to be done; None without a fault."""
        union = Fault(0)
        for faults in self.faults:
            union |= faults
        order = (Fault.MOTOR, Fault.COMMUNICATION, Fault.OVER_TEMPERATURE, Fault.OVER_CURRENT, Fault.STALL)
        return next((fault for fault in order if fault in union), None)

    @property
    def error(self) -> DeviceError | None:
        """The error for the gravest fault, with its code; None without a fault."""
        if self.worst is None:
            return None
        code, _, remedy = FAULT_CODES[self.worst]
        then = "" if self.worst is Fault.OVER_TEMPERATURE else ", then clear its faults"
        message = f"the hand reports a fault ({self.described}): {remedy}{then}; it keeps its grip"
        return DeviceError(message, code=code)


def pack(values: tuple[int, ...], order: str) -> bytes:
    """Encode one 16-bit number for each motor.

    Args:
        values: The six numbers.
        order: Order of the bytes of a number, `HandLine.order`.

    Returns:
        12 bytes.
    """
    return struct.pack(f"{order}6h", *values)


def unpack_angles(payload: bytes, order: str) -> tuple[int, ...]:
    """Decode ANGLE_ACT.

    Args:
        payload: ANGLES_LENGTH bytes.
        order: Order of the bytes of a number, `HandLine.order`.

    Returns:
        The six angles [counts].

    Raises:
        ProtocolError: An angle is one that no RH56 has.
    """
    angles = struct.unpack(f"{order}6h", payload)
    if not all(-FULL <= angle <= 2 * FULL for angle in angles):
        raise ProtocolError(f"the hand says that its angles are {angles}, of {FULL}: is it an RH56?", code=_NOT_OURS)
    return angles


def unpack_condition(payload: bytes, order: str) -> Condition:
    """Decode FORCE_ACT, CURRENT, ERROR, STATUS and TEMPERATURE.

    Args:
        payload: CONDITION_LENGTH bytes.
        order: Order of the bytes of a number, `HandLine.order`.

    Returns:
        What they say.

    Raises:
        ProtocolError: A value is one that no RH56 has.
    """
    numbers = struct.unpack(order + _CONDITION, payload)
    forces, currents, errors, statuses, temperatures = (numbers[i : i + 6] for i in range(0, 30, 6))
    known = {*Status}
    if max(errors) > sum(Fault) or not known.issuperset(statuses) or max(temperatures) > _WORST_TEMPERATURE:
        message = f"the hand reports errors {errors}, states {statuses} and {temperatures} deg C: is it an RH56?"
        raise ProtocolError(message, code=_NOT_OURS)
    return Condition(forces, currents, tuple(map(Fault, errors)), tuple(map(Status, statuses)), temperatures)


_NOT_OURS = "protocol.hand_values"
