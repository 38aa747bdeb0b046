"""Emulator of a PSYONIC Ability Hand on a pseudo-terminal, for drivers that speak the maker's extended API.

    with AbilityEmulator() as emulator:
        emulator.hold(60)              # a handle, met by the fingers at 60 deg
        serial.Serial(emulator.port)   # a driver's side

It is written from the maker's Interface Control Document (ICD) and from its recordings, not from the project's driver,
with which it shares no code. What it does is

- published (ICD 3.1 to 3.5): frames, stuffing, checksum, headers and variants of replies, units, order and signs of the
  motors, 12-bit touch pads, that a message may be cut short, 0.3 s until the API mode ends, that read-only messages
  keep it up but do not enter it, that a finger that collides may not go on in that direction until it is told to go the
  other way, that such a command may be taken for a collision in turn, shut-down of a hot motor or of all, the bits that
  tell of both; from the maker's URDF: ranges and fastest speeds; from one recorded frame: what the pads say at rest;
- assumed: that the fingers open when the API mode ends (the ICD: "may be accompanied by undesired finger movements"),
  how stiff what it holds is, the force at which a finger counts as having collided, the share of the pads in it, noise
  of the pads, temperatures, 1 ms until it answers, 20 ms until it moves, silence after a damaged or a longer message,
  that stuffing is switched on.

Not there: I2C, Bluetooth, fast mode, commands of velocities, currents and voltages, which are answered and move
nothing, velocities and currents in replies, which are 0, the registers, slave networks.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

from toolee_robot.robots.hands.ability import joints_of_closures
from toolee_robot.sim_backend.hands.kit import (
    Address,
    EmulatedHand,
    HandEmulator,
    HandTime,
    LineEmulator,
    LineFaults,
    Motor,
    PseudoTerminal,
)
from toolee_robot.station import HandConfig

NAMES = ("index", "middle", "ring", "little", "thumb_flexor", "thumb_rotator")
"""The motors in the order of the messages."""
SIGNS = (1, 1, 1, 1, 1, -1)
"""Sign on the wire of closing: the rotator's range is 0 to -100 deg."""
RANGE = 100.0
"""Way of every motor [deg]."""
UNIT = 150.0 / 32767.0
"""Degrees of a position's count."""
API_S = 0.3
"""Time without a message after which the API mode ends: published."""
FASTEST = (462.25,) * 5 + (2311.25,)
"""Fastest speeds [deg/s]: of the maker's URDF."""
PADS_AT_REST = (
    138, 149, 188, 811, 102, 218, 1634, 546, 124, 481, 456, 1513, 1725, 713, 155, 1204, 404, 679, 498, 196, 166, 1474,
    497, 370, 163, 186, 1160, 1252, 332, 351,
)  # fmt: skip
"""What the pads of one hand said in a frame that the maker recorded [counts]."""
PRESSED = 3
"""Pads of a finger that share its force: assumed."""
GAIN = 15.0
"""Speed by the way that is left [1/s]: assumed."""
STIFFNESS = 2.0
"""Force by the way that a finger has pressed into what it holds [N/deg]: assumed."""
COLLISION_FORCE = 10.0
"""Force at which a slow finger counts as having collided [N]: assumed."""
COLLISION_S = 0.01
"""Time for which a finger goes on by its momentum: assumed."""
STALL_S = 0.05
"""Time for which a blocked motor pushes until it counts as having collided: assumed."""
HOT, COOL = 70.0, 60.0
"""Temperatures at which a motor is shut down, and works again [deg C]: assumed."""
NEAR = 0.05
"""Way to a target that counts as none [deg]."""
TURNAROUND_S, BYTE_S = 0.001, 10.0 / 460800.0
"""Time that the hand takes for a reply: assumed; the maker's client asks 500 times a second; and of a byte."""


@dataclass
class AbilityMotor(Motor):
    """One of the six motors, from 0 (open) to RANGE (closed) [deg] whatever its sign on the wire.

    Attributes:
        reaction: See `Motor`: assumed.
        fastest: Its fastest speed [deg/s].
        chance: Draws whether opening is taken for a collision.
        pushing: Time for which it has pushed without moving [s].
    """

    reaction: ClassVar[float] = 0.02
    fastest: float = FASTEST[0]
    backdrivable: bool = False
    """Whether it can be pushed back: such a one is never stopped by a collision."""
    shut_down: bool = False
    """Whether it is too hot to move."""
    barred: int = 0
    """Direction in which it may not go on, 1 closing, -1 opening; 0 for none."""
    ratchets: float = 0.1
    """Probability that opening after a grasp is taken for a collision."""
    chance: random.Random = field(default_factory=random.Random)
    pushing: float = 0.0

    @property
    def force(self) -> float:
        """Force of the finger on what it holds [N]."""
        return 0.0 if self.met_at is None else max(0.0, STIFFNESS * (self.position - self.met_at))

    @property
    def direction(self) -> int:
        """Where it is told to go: 1 closing, -1 opening, 0 nowhere."""
        way = 0.0 if self.target is None else self.target - self.position
        return (way > NEAR) - (way < -NEAR)

    @property
    def limited(self) -> bool:
        """Whether it does not do what it is told, to protect itself."""
        return self.shut_down or (self.barred != 0 and self.barred == self.direction)

    def heed(self, target: float) -> None:
        """Begin to go to a target."""
        self.target = target
        if self.barred and self.direction == -self.barred:
            grasped = self.barred == 1 and self.force >= 0.5 * COLLISION_FORCE
            self.barred, self.pushing = 0, 0.0
            if grasped and self.chance.random() < self.ratchets:
                self.barred = -1

    def move(self, now: float, step: float) -> None:  # noqa: ARG002
        """Move unless it is hot, barred, stuck or has collided."""
        if self.temperature >= HOT or self.temperature <= COOL:
            self.shut_down = self.temperature >= HOT
        if self.target is None or self.shut_down or not self.direction or self.direction == self.barred:
            return
        way = self.target - self.position
        speed = min(max(GAIN * way, -self.fastest), self.fastest)
        if self.jammed:
            self.pushing += step
            if self.pushing >= STALL_S and not self.backdrivable:
                self.barred, self.pushing = self.direction, 0.0
        elif way > 0.0 and self.force >= COLLISION_FORCE:
            if not self.backdrivable:
                self.barred = 1
                self.position += COLLISION_S * speed
        else:
            self.position = min(max(self.position + speed * step, 0.0), RANGE)


class Hand(EmulatedHand[AbilityMotor]):
    """The hand, with its API mode; the time is `clock`'s, noise and chance are of the seed."""

    def __init__(self, clock: Callable[[], float], seed: int = 0) -> None:
        self._chance = random.Random(seed)
        motors = [
            AbilityMotor(fastest=fastest, backdrivable=name == "thumb_rotator", chance=self._chance)
            for name, fastest in zip(NAMES, FASTEST, strict=True)
        ]
        super().__init__(clock, motors, range(5))
        self.has_pads = True
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
        return tuple(sign * angle for sign, angle in zip(SIGNS, super().angles, strict=True))

    def before_step(self) -> None:
        """The ICD: an end of the API mode may be accompanied by undesired movements. Here they open, the worst."""
        if self._api_until is not None and self.now >= self._api_until:
            self._leave_api()

    def _leave_api(self) -> None:
        self._api_until = None
        for motor in self.motors:
            motor.go(0.0, self.now)

    def answer(self, header: int, payload: bytes) -> bytes:
        """Carry out a message to this hand, and return the frame that answers it."""
        self.run()
        mode, variant = header & 0xF0, header & 0x0F
        if mode in (0x10, 0x20, 0x30, 0x40, 0xA0) and variant <= 2:
            self._header = header
        if header == 0x7C:
            if self._api_until is not None:
                self._leave_api()
        elif mode != 0xA0 or self._api_until is not None:
            self._api_until = self.now + API_S
        if mode == 0x10 and variant <= 2:
            values = struct.unpack(f"<{len(payload) // 2}h", payload[: len(payload) // 2 * 2])
            for motor, sign, value in zip(self.motors, SIGNS, values, strict=False):
                motor.go(sign * value * UNIT, self.now)
        return self._reply()

    def _reply(self) -> bytes:
        counts = [max(-32767, min(32767, round(angle / UNIT))) for angle in self.angles]
        frame = bytes([self._header]) + b"".join(struct.pack("<hh", count, 0) for count in counts)
        if self._header & 0x0F == 2:
            frame += bytes(12)
        else:
            bits = sum(pad << 12 * i for i, pad in enumerate(self._pads()))
            frame += bits.to_bytes(45, "little")
        return stuffed(frame + bytes([sum(motor.limited << i for i, motor in enumerate(self.motors))]))

    def _pads(self) -> list[int]:
        if not self.has_pads:
            return [0] * 30
        pads = []
        for pad, rest in enumerate(PADS_AT_REST):
            force = self.motors[pad // 6].force / PRESSED if pad % 6 < PRESSED else 0.0
            conductance = 1.0 / (33000.0 / (rest * 3.3 / 4096.0) + 10000.0) + force / 121591.0
            volts = 33000.0 / (1.0 / conductance - 10000.0) if conductance < 5e-5 else 3.3
            pads.append(max(1, min(4095, round(volts * 4096.0 / 3.3) + self._chance.randint(-2, 2))))
        return pads


def stuffed(frame: bytes) -> bytes:
    """Add the sum that makes it zero, the flags, and the escapes to a reply."""
    line = [0x7E]
    for byte in (*frame, -sum(frame) % 256):
        line += [0x7D, byte ^ 0x20] if byte in (0x7D, 0x7E) else [byte]
    return bytes([*line, 0x7E])


def unstuffed(line: bytes) -> bytes:
    """Take the escapes out of what is between two flags."""
    return line.replace(b"\x7d\x5e", b"\x7e").replace(b"\x7d\x5d", b"\x7d")


def foreign(frame: bytes) -> bytes:
    """Make a reply to somebody else's command, for voltages, out of one."""
    body = unstuffed(frame[1:-1])
    return stuffed(bytes([0x40 | body[0] & 0x0F]) + body[1:-1])


class AbilityEmulator(LineEmulator[Hand]):
    """A PSYONIC Ability Hand that a driver finds at `port`.

    Args:
        address: The hand's address on the line.
        seed: Seed of noise and chance.
        pace: Rate of the hand's time relative to the host's, in which its API mode ends, too; the line keeps to the
            host's.

    Attributes:
        ignored: Number of frames that were damaged, too long, or for another hand.
    """

    label = "PSYONIC Ability Hand"
    most = RANGE
    motors = NAMES
    fingers = {finger: (finger,) for finger in NAMES[:4]} | {"thumb": ("thumb_flexor",)}
    joints = staticmethod(joints_of_closures)
    events = "heat MOTOR DEGREES, heat DEGREES, jam MOTOR, free MOTOR, pads off, pads on"

    def __init__(self, address: int = 0x50, seed: int = 0, pace: float = 1.0) -> None:
        clock = HandTime(pace)
        super().__init__(Hand(clock, seed), PseudoTerminal(), LineFaults(foreign, seed), clock, TURNAROUND_S, BYTE_S)
        self._address, self.ignored = address, 0

    def happen(self, event: str, motor: int | None, *words: str) -> None:
        """See `HandEmulator.happen`; a hand without pads says 0 in their place."""
        if event == "pads" and motor is None and words in (("on",), ("off",)):
            self.tell(lambda hand: setattr(hand, "has_pads", words == ("on",)))
        else:
            super().happen(event, motor, *words)

    def answer(self, data: bytes) -> list[bytes]:
        """Answer the messages in the stream of bytes."""
        *lines, self.stream = (self.stream[-64:] + data).split(b"\x7e")
        replies = []
        for body in map(unstuffed, filter(None, lines)):
            if 3 <= len(body) <= 15 and not sum(body) % 256 and body[0] == self._address:
                replies.append(self._hand.answer(body[1], body[2:-1]))
            else:
                self.ignored += 1
        return replies


def emulate(config: HandConfig, _: Address, seed: int, pace: float) -> HandEmulator[Hand]:
    """Build the emulator of a station's hand."""
    return AbilityEmulator(getattr(config, "hand_id", None) or 0x50, seed, pace)
