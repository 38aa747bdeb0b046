"""The emulated hand: its registers, and what reading and writing them does."""

from __future__ import annotations

import struct
from collections.abc import Callable

from toolee_robot.sim_backend.inspire_hand.motor import RANGE, Motor

NAMES = ("little", "ring", "middle", "index", "thumb_bend", "thumb_rotation")
"""The motors in the order of the registers."""
STEP = 0.002
"""Longest step of the motors [s]."""
_THUMB_ROTATION = 5
IDENTIFIER, CLEAR, SAVE, CALIBRATE = 1000, 1004, 1005, 1009
"""Registers of a single byte that can be written."""
WORDS = (1472, 1474, 1486, 1498, 1522, 1534, 1546, 1582, 1594)
"""First registers of the blocks of 16-bit numbers, in which the low byte comes first."""
_VOLTAGE = 24000


class Hand:
    """The hand at one end of the line; it does not know of ports. Not safe for several threads.

    Args:
        clock: Returns the time [s].
        number: The hand's number on the line.

    Attributes:
        motors: The six motors, little finger first.
        number: The hand's number.
    """

    def __init__(self, clock: Callable[[], float], number: int = 1) -> None:
        self.motors = tuple(Motor() for _ in NAMES)
        self.number = number
        self._clock, self._now = clock, clock()
        self._calibration: list[tuple[float, tuple[float, ...]]] = []

    @property
    def angles(self) -> tuple[float, ...]:
        """Where the motors are now [counts], in the order of NAMES."""
        self.run()
        return tuple(motor.position for motor in self.motors)

    @property
    def told(self) -> tuple[tuple[float, float, float], ...]:
        """Target, threshold and speed that each motor was given last."""
        return tuple(motor.told for motor in self.motors)

    def hold(self, met_at: float | None, *, thumb: float | None = None) -> None:
        """Put something into the hand, or take it out.

        Args:
            met_at: Angle at which the fingers meet it [counts]; None for nothing.
            thumb: That of the thumb; None for the same.
        """
        self.run()
        for motor in self.motors[:4]:
            motor.met_at = met_at
        self.motors[4].met_at = met_at if thumb is None else thumb

    def slip(self, way: float) -> None:
        """Let what the hand holds give way.

        Args:
            way: By how much further the fingers have to close to meet it [counts].
        """
        self.run()
        for motor in self.motors:
            if motor.met_at is not None:
                motor.met_at -= way

    def run(self) -> None:
        """Let the motors move until now."""
        end = self._clock()
        while self._now < end:
            step = min(STEP, end - self._now)
            self._now += step
            while self._calibration and self._calibration[0][0] <= self._now:
                _, targets = self._calibration.pop(0)
                for motor, target in zip(self.motors, targets, strict=True):
                    motor.go(target, self._now)
            for motor in self.motors:
                motor.advance(self._now, step)

    def read(self, address: int, count: int) -> bytes:
        """Read registers.

        Args:
            address: Address of the first byte.
            count: Number of bytes.

        Returns:
            The bytes, those of a number low byte first; 0 where there is no register.
        """
        self.run()
        words = {first: struct.pack(f"<{len(values)}h", *values) for first, values in self._words().items()}
        blocks = words | self._bytes()
        data = bytearray(count)
        for first, block in blocks.items():
            for i, value in enumerate(block, first - address):
                if 0 <= i < count:
                    data[i] = value
        return bytes(data)

    def write(self, address: int, data: bytes) -> bool:
        """Write registers.

        Args:
            address: Address of the first byte.
            data: The bytes, those of a number low byte first.

        Returns:
            Whether they can be written; otherwise nothing is.
        """
        self.run()
        if address == IDENTIFIER and len(data) == 1 and 1 <= data[0] <= 254:
            self.number = data[0]
            return True
        if address in (CLEAR, SAVE, CALIBRATE) and data == b"\x01":
            if address == CLEAR:
                for motor in self.motors:
                    motor.clear()
            if address == CALIBRATE:
                self._calibrate()
            return True
        for first, take in ((1486, self._aim), (1498, self._limit), (1522, self._pace)):
            if first <= address and address + len(data) <= first + 12 and (address - first) % 2 == len(data) % 2 == 0:
                for i in range(0, len(data), 2):
                    (value,) = struct.unpack_from("<h", data, i)
                    take(self.motors[(address - first + i) // 2], value)
                return True
        return False

    def _words(self) -> dict[int, list[int]]:
        motors = self.motors
        return {
            1472: [_VOLTAGE],
            1474: [round(2.0 * (RANGE - motor.target)) for motor in motors],
            1486: [round(motor.target) for motor in motors],
            1498: [round(motor.threshold) for motor in motors],
            1522: [round(motor.speed) for motor in motors],
            1534: [round(2.0 * (RANGE - motor.position)) for motor in motors],
            1546: [round(motor.position) for motor in motors],
            1582: [round(motor.force) for motor in motors],
            1594: [round(motor.current) for motor in motors],
        }

    def _bytes(self) -> dict[int, bytes]:
        return {
            IDENTIFIER: bytes([self.number]),
            1606: bytes(motor.error for motor in self.motors),
            1612: bytes(motor.status for motor in self.motors),
            1618: bytes(round(motor.temperature) for motor in self.motors),
        }

    def _aim(self, motor: Motor, value: int) -> None:
        if 0 <= value <= RANGE:
            motor.go(value, self._now)

    def _limit(self, motor: Motor, value: int) -> None:
        motor.threshold = min(max(value, 0), RANGE)

    def _pace(self, motor: Motor, value: int) -> None:
        motor.speed = min(max(value, 0), RANGE)

    def _calibrate(self) -> None:
        """Five motions in 6 s: all open, fingers bent, open, thumb bent, open."""
        aside = self.motors[_THUMB_ROTATION].position
        bends = ((RANGE,) * 5, (*(0.0,) * 4, RANGE), (RANGE,) * 5, (*(RANGE,) * 4, 0.0), (RANGE,) * 5)
        self._calibration = [(self._now + 1.2 * i, (*bend, aside)) for i, bend in enumerate(bends)]
