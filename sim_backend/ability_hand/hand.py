"""The emulated hand: what its messages do, and what it answers."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

from toolee_robot.sim_backend.ability_hand.messages import Message, reply
from toolee_robot.sim_backend.ability_hand.motor import Motor
from toolee_robot.sim_backend.hand_wire import Frame

NAMES = ("index", "middle", "ring", "little", "thumb_flexor", "thumb_rotator")
"""The motors in the order of the messages."""
SIGNS = (1, 1, 1, 1, 1, -1)
"""Sign on the wire of closing: the rotator's range is 0 to -100 deg."""
API_TIME = 0.3
"""Time without a message after which the API mode ends [s]: published."""
FASTEST = (462.25,) * 5 + (2311.25,)
"""Fastest speeds [deg/s]: of the maker's URDF."""
GEARS = (649.0,) * 5 + (162.45,)
"""Turns of the rotor for one of the finger: published."""
PADS_AT_REST = (
    138, 149, 188, 811, 102, 218, 1634, 546, 124, 481, 456, 1513, 1725, 713, 155, 1204, 404, 679, 498, 196, 166, 1474,
    497, 370, 163, 186, 1160, 1252, 332, 351,
)  # fmt: skip
"""What the pads of one hand said in a frame that the maker recorded [counts]."""
PRESSED = 3
"""Pads of a finger that share its force: assumed."""
STEP = 0.002
"""Longest step of the motors [s]."""
_AMPERE = 620.606
_VELOCITY, _DUTY, _TORQUE = 3000.0 / 32767.0, 1.0 / 3546.0, 1.0 / _AMPERE


class Hand:
    """The hand at one end of the line; it does not know of ports. Not safe for several threads.

    Args:
        clock: Returns the time [s].
        seed: Seed of noise and chance.

    Attributes:
        motors: The six motors in the order of NAMES.
        has_pads: Whether it has touch pads; a hand without them says 0 in their place.
    """

    def __init__(self, clock: Callable[[], float], seed: int = 0) -> None:
        self._chance = random.Random(seed)
        self.motors = tuple(
            Motor(fastest, backdrivable=name == "thumb_rotator", chance=self._chance)
            for name, fastest in zip(NAMES, FASTEST, strict=True)
        )
        self.has_pads = True
        self._clock, self._now = clock, clock()
        self._api_until: float | None = None
        self._header = 0x10

    @property
    def in_api(self) -> bool:
        """Whether it is in the API mode."""
        self.run()
        return self._api_until is not None

    @property
    def angles(self) -> tuple[float, ...]:
        """Where the motors are now, as on the wire [deg]."""
        self.run()
        return tuple(sign * motor.position for sign, motor in zip(SIGNS, self.motors, strict=True))

    @property
    def told(self) -> tuple[tuple[float | None, float], ...]:
        """Target and speed that each motor was given last [deg], [deg/s]."""
        return tuple(motor.told for motor in self.motors)

    def hold(self, met_at: float | None, *, thumb: float | None = None) -> None:
        """Put something into the hand, or take it out.

        Args:
            met_at: Angle at which the fingers meet it [deg]; None for nothing.
            thumb: That of the thumb's flexor; None for the same.
        """
        self.run()
        for motor in self.motors[:4]:
            motor.met_at = met_at
        self.motors[4].met_at = met_at if thumb is None else thumb

    def slip(self, way: float) -> None:
        """Let what the hand holds give way.

        Args:
            way: By how much further the fingers have to close to meet it [deg].
        """
        self.run()
        for motor in self.motors:
            if motor.met_at is not None:
                motor.met_at += way

    def heat(self, degrees: float) -> None:
        """Let the palm get this hot [deg C], and all motors with it."""
        self.run()
        for motor in self.motors:
            motor.temperature = degrees

    def run(self) -> None:
        """Let the motors move until now."""
        end = self._clock()
        while self._now < end:
            step = min(STEP, end - self._now)
            self._now += step
            if self._api_until is not None and self._now >= self._api_until:
                self._leave_api()
            for motor in self.motors:
                motor.advance(self._now, step)

    def answer(self, message: Message) -> list[Frame]:
        """Carry out a message.

        Args:
            message: A message to this hand.

        Returns:
            The frames that answer it.
        """
        self.run()
        header = message.header
        mode, variant = header & 0xF0, header & 0x0F
        if mode in (0x10, 0x20, 0x30, 0x40, 0xA0) and variant <= 2:
            self._header = header
        if mode in (0x10, 0x20, 0x30, 0x40) and variant <= 2:
            self._api_until = self._now + API_TIME
            for motor, sign, value in zip(self.motors, SIGNS, message.values, strict=False):
                self._command(motor, mode, sign * value)
        elif header == 0x7C:
            if self._api_until is not None:
                self._leave_api()
        elif mode != 0xA0 or self._api_until is not None:
            self._api_until = self._now + API_TIME
        return [Frame(self._reply())]

    def _command(self, motor: Motor, mode: int, value: int) -> None:
        if mode == 0x10:
            motor.go(value * 150.0 / 32767.0, 0.0, self._now)
        elif mode == 0x20:
            motor.go(None, value * _VELOCITY, self._now)
        else:
            share = value * (_DUTY if mode == 0x40 else _TORQUE)
            motor.go(None, min(max(share, -1.0), 1.0) * motor.fastest, self._now)

    def _leave_api(self) -> None:
        """The ICD: accompanied by undesired finger movements, perhaps. Here they open, the worst that can be."""
        self._api_until = None
        for motor in self.motors:
            motor.go(0.0, 0.0, self._now)

    def _reply(self) -> bytes:
        motors = self.motors
        currents = [
            round(sign * _AMPERE * (0.2 if motor.velocity else 0.0)) for sign, motor in zip(SIGNS, motors, strict=True)
        ]
        velocities = [
            max(-32767, min(32767, round(4.0 * gear * sign * math.radians(motor.velocity))))
            for sign, gear, motor in zip(SIGNS, GEARS, motors, strict=True)
        ]
        limited = sum(1 << i for i, motor in enumerate(motors) if motor.limited)
        return reply(self._header, self.angles, currents, velocities, self._pads(), limited)

    def _pads(self) -> list[int]:
        if not self.has_pads:
            return [0] * 30
        pads = []
        for pad, rest in enumerate(PADS_AT_REST):
            force = self.motors[pad // 6].force / PRESSED if pad % 6 < PRESSED else 0.0
            volts = rest * 3.3 / 4096.0
            conductance = 1.0 / (33000.0 / volts + 10000.0) + force / 121591.0
            pressed = 33000.0 / (1.0 / conductance - 10000.0) if conductance < 5e-5 else 3.3
            noise = self._chance.randint(-2, 2)
            pads.append(max(1, min(4095, round(pressed * 4096.0 / 3.3) + noise)))
        return pads
