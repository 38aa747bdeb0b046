"""Emulator of an Inspire RH56 hand, for drivers that speak the maker's frames or Modbus-TCP.

    with InspireEmulator() as emulator:
        emulator.hold(400)             # a handle, met by the fingers at 400 of 1000
        serial.Serial(emulator.port)   # a driver's side
    with ModbusEmulator(("127.0.0.1", 6000)) as emulator:   # the same hand with Ethernet
        ...

It is written from the maker's frames, the Modbus specification and measurements, not from the project's driver, with
which it shares no code. What the hand does is

- published (the maker's manual V1.0.9, sections 2.2 and 2.4): frames and checksum, register addresses and sizes, order
  of the motors, 0.8 s for the whole range at speed 1000, targets of -1, force thresholds, bits of ERROR, values of
  STATUS;
- measured (arXiv 2603.08988 and its repository): 6.6 ms for a read of 12 bytes, 66 ms from a command to its motion, the
  overshoot of the force threshold that follows from it (by its order), a stuck finger that reports its position as
  reached, states of 255 before the first command;
- assumed: the stiffness of what is held, temperatures and currents, 0.5 s until a blocked motor counts as stalled, that
  a motor at its force threshold stands until the next command, that a motor with a fault does not move, that heat is
  not cleared by CLEAR_ERROR, silence after a request that is damaged or not for this hand, a result of 0 for a write to
  what cannot be written.

Of Modbus-TCP is

- published (the RH56DFTP's manual PRJ-02-TS-U-010, V1.0.0, section 2.6, as the package inspire_rh56dftp 0.1.0 quotes
  it): port 6000, functions 03 and 16, addresses, which count bytes; exceptions are the specification's;
- seen by the author of inspire_rh56dftp: big-endian numbers, transaction identifiers that are off by one
  (`ModbusEmulator.shift`), a connection that is ended if it is made less than 0.3 s after the last one, there
  sometimes, here always;
- assumed: of two single bytes the first one is the high byte, but a single one is written in the low byte, with
  function 06 (as github.com/laurent-19/inspire_hand_ws has it); 2 ms for a reply; exceptions 2 and 3 for what cannot be
  read or written, silence for another unit, one connection at a time.

Not there: SAVE, the calibration of the force sensors, a change of the hand's number.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

from toolee_robot.robots.hands.inspire import joints_of_counts
from toolee_robot.sim_backend.hands.kit import (
    ACKNOWLEDGE,
    Address,
    EmulatedHand,
    HandEmulator,
    HandTime,
    LineEmulator,
    LineFaults,
    Motor,
    PseudoTerminal,
    TcpServer,
    Wire,
    WriteFault,
)
from toolee_robot.station import HandConfig

NAMES = ("little", "ring", "middle", "index", "thumb_bend", "thumb_rotation")
"""The motors in the order of the registers."""
RANGE = 1000.0
FULL_SPEED = RANGE / 0.8
"""Counts a second at speed 1000: published."""
REACTION_S = 0.066
"""Time from a command, or from a force, until the motor heeds it: measured."""
STIFFNESS = 20.0
"""Force by the way that a finger has pressed into what it holds [counts of each]: assumed, so that the threshold is
overshot by about what was measured."""
STALL_S = 0.5
"""Time for which a motor pushes without moving until it counts as stalled: assumed."""
HOT, COOL = 70.0, 60.0
"""Temperatures at which a motor stops, and at which it works again [deg C]: assumed."""
STALLED, OVERHEATED, OVER_CURRENT = 1, 2, 4
"""Bits of ERROR that have a meaning here; 8 is a failure of the motor, 16 one of the hand's own communication."""
RELEASING, GRASPING, ARRIVED, PRESSED, CURRENT_STOP, STALL_STOP, FAULT_STOP, NEVER = 0, 1, 2, 3, 5, 6, 7, 255
"""Values of STATUS."""
CLEAR = 1004
"""Register of a single byte that can be written."""
REGISTERS = range(1000, 5124)
TURNAROUND_S, BYTE_S = 0.0041, 10.0 / 115200.0
"""Time that the hand takes for a reply, with the 29 bytes of a read of 12 bytes the measured 6.6 ms; and of a byte."""
TCP_TURNAROUND_S, TCP_BYTE_S = 0.002, 8.0e-8
"""The same on Ethernet: assumed; at 100 Mbit/s."""
GRACE_S = 0.3
"""Time after the end of a connection for which a hand was seen to end the next one at once."""


@dataclass
class InspireMotor(Motor):
    """One of the six motors, from 0 (bent) to RANGE (stretched) [counts].

    Attributes:
        reaction: See `Motor`.
        position: See `Motor`.
        target: See `Motor`.
        speed: Speed as commanded, 0 to 1000.
        error: Bits of ERROR.
        status: Value of STATUS.
        stands: Whether it has ended its motion.
        pushing: Time for which it has pushed without moving [s].
        forces: Times and forces that it has not felt yet.
    """

    reaction: ClassVar[float] = REACTION_S
    position: float = RANGE
    target: float | None = RANGE
    speed: float = RANGE
    threshold: float = 500.0
    """Force at which it stops closing [counts]."""
    says_arrived: bool = False
    """Fault: it reports that it has arrived although it is jammed, as one hand did."""
    error: int = 0
    status: int = NEVER
    stands: bool = True
    pushing: float = 0.0
    forces: deque[tuple[float, float]] = field(default_factory=deque)

    @property
    def force(self) -> float:
        """Force of the finger on what it holds [counts]."""
        return 0.0 if self.met_at is None else max(0.0, STIFFNESS * (self.met_at - self.position))

    def heed(self, target: float) -> None:
        """Begin to go to a target."""
        self.target, self.stands, self.pushing = target, False, 0.0

    def move(self, now: float, step: float) -> None:
        """Move until it has arrived, presses enough, is stuck, or has a fault."""
        if self.temperature >= HOT or self.temperature <= COOL:
            self.error = self.error & ~OVERHEATED | OVERHEATED * (self.temperature >= HOT)
        felt = 0.0
        while self.forces and self.forces[0][0] <= now - REACTION_S:
            _, felt = self.forces.popleft()
        if self.error and not self.stands:
            self.stands = True
            self.status = {STALLED: STALL_STOP, OVER_CURRENT: CURRENT_STOP}.get(self.error, FAULT_STOP)
        elif not self.stands:
            self._go_on(step, felt)
        self.forces.append((now, self.force))

    def _go_on(self, step: float, felt: float) -> None:
        way = (self.target or 0.0) - self.position
        if abs(way) < 0.5 or (self.jammed and self.says_arrived):
            self.stands, self.status = True, ARRIVED
        elif way < 0.0 and felt >= self.threshold:
            self.stands, self.status = True, PRESSED
        elif self.jammed:
            self.pushing += step
            if self.pushing >= STALL_S:
                self.error, self.stands, self.status = self.error | STALLED, True, STALL_STOP
        else:
            self.status = GRASPING if way < 0.0 else RELEASING
            most = FULL_SPEED * self.speed / RANGE * step
            self.position += min(max(way, -most), most)


class Hand(EmulatedHand[InspireMotor]):
    """The hand with its registers, whose numbers are low byte first; the time is `clock`'s."""

    def __init__(self, clock: Callable[[], float]) -> None:
        super().__init__(clock, [InspireMotor() for _ in NAMES], range(5), closing=-1.0)

    @property
    def told(self) -> tuple[tuple[float | None, float, float], ...]:
        """Target, threshold and speed that each motor was given last."""
        targets = zip(super().told, self.motors, strict=True)
        return tuple((target, motor.threshold, motor.speed) for target, motor in targets)

    def words(self) -> dict[int, list[float]]:
        """First register of each block of six 16-bit numbers -> the numbers."""
        motors = self.motors
        return {
            1486: [motor.target or 0.0 for motor in motors],
            1498: [motor.threshold for motor in motors],
            1522: [motor.speed for motor in motors],
            1546: [motor.position for motor in motors],
            1582: [motor.force for motor in motors],
            1594: [20.0 if motor.stands else 150.0 + 0.5 * motor.force for motor in motors],  # assumed [mA]
        }

    def read(self, address: int, count: int) -> bytes:
        """Read bytes from a register on; 0 where there is none."""
        self.run()
        blocks = {first: struct.pack("<6h", *map(round, values)) for first, values in self.words().items()}
        for first, name in ((1606, "error"), (1612, "status"), (1618, "temperature")):
            blocks[first] = bytes(round(getattr(motor, name)) for motor in self.motors)
        data = bytearray(count)
        for first, block in blocks.items():
            for i, value in enumerate(block, first - address):
                if 0 <= i < count:
                    data[i] = value
        return bytes(data)

    def write(self, address: int, data: bytes) -> bool:
        """Write bytes from a register on; whether they can be written, otherwise nothing is."""
        self.run()
        if address == CLEAR and data == b"\x01":
            for motor in self.motors:
                motor.error, motor.pushing = motor.error & OVERHEATED, 0.0
            return True
        for first, name in ((1486, "target"), (1498, "threshold"), (1522, "speed")):
            if first <= address and address + len(data) <= first + 12 and (address - first) % 2 == len(data) % 2 == 0:
                for i, (value,) in enumerate(struct.iter_unpack("<h", data), (address - first) // 2):
                    if name != "target":
                        setattr(self.motors[i], name, float(min(max(value, 0), RANGE)))
                    elif 0 <= value <= RANGE:
                        self.motors[i].go(float(value), self.now)
                return True
        return False


class InspireEmulator(LineEmulator[Hand]):
    """An Inspire RH56 on RS-485, a pseudo-terminal, that a driver finds at `port`.

    Args:
        number: The hand's number on the line.
        seed: Seed of the line's noise.
        pace: Rate of the motors' time relative to the host's; the line keeps to the host's.
    """

    label = "Inspire RH56"
    most = RANGE
    motors = NAMES
    fingers = {finger: (finger,) for finger in NAMES[:4]} | {"thumb": ("thumb_bend",)}
    joints = staticmethod(joints_of_counts)
    events = "heat MOTOR DEGREES, jam MOTOR, free MOTOR, error MOTOR BITS"
    line_events = (*HandEmulator.line_events, *WriteFault, ACKNOWLEDGE)

    def __init__(self, number: int = 1, seed: int = 0, pace: float = 1.0) -> None:
        self._connect(number, pace, PseudoTerminal(), LineFaults(foreign, seed), TURNAROUND_S, BYTE_S)

    def _connect(
        self, number: int, pace: float, wire: Wire, faults: LineFaults, turnaround: float, byte_time: float
    ) -> None:
        clock = HandTime(pace)
        super().__init__(Hand(clock), wire, faults, clock, turnaround, byte_time)
        self.number, self.ignored = number, 0

    def happen(self, event: str, motor: int | None, *words: str) -> None:
        """See `HandEmulator.happen`; an error stays until it is cleared, but heat, which goes with the temperature."""
        if event == "error" and motor is not None:
            bits = int(*words)
            if not 1 <= bits < 32 or bits & OVERHEATED:
                raise ValueError(bits)

            def fail(hand: Hand) -> None:
                hand.run()
                hand.motors[motor].error |= bits

            self.tell(fail)
        elif motor is None:
            raise ValueError(event)
        else:
            super().happen(event, motor, *words)

    def answer(self, data: bytes) -> list[bytes]:
        """Answer the requests in the stream of bytes."""
        self.stream += data
        replies = []
        while (begin := self.stream.find(b"\xeb\x90")) >= 0 and len(self.stream) >= begin + 4:
            end = begin + 5 + self.stream[begin + 3]
            if len(self.stream) < end:
                break
            replies += self._carry_out(self.stream[begin + 2 : end])
            self.stream = self.stream[end:]
        return replies

    def _carry_out(self, body: bytes) -> list[bytes]:
        if len(body) < 7 or sum(body[:-1]) & 0xFF != body[-1] or body[0] != self.number or body[2] not in (0x11, 0x12):
            self.ignored += 1
            return []
        command, address, payload = body[2], body[3] + 256 * body[4], body[5:-1]
        if command == 0x11:
            return [reply(self.number, command, address, self._hand.read(address, payload[0]))]
        return self.faults.write(
            lambda: [reply(self.number, command, address, bytes([self._hand.write(address, payload)]))]
        )


def reply(number: int, command: int, address: int, data: bytes) -> bytes:
    """Build a reply on RS-485 to a command at an address: what was read, or the result of a write."""
    body = bytes([number, len(data) + 3, command, address % 256, address // 256, *data])
    return b"\x90\xeb" + body + bytes([sum(body) % 256])


def foreign(frame: bytes) -> bytes:
    """Make the reply of the hand with the next number out of one."""
    return reply(frame[2] % 254 + 1, frame[4], frame[5] + 256 * frame[6], frame[7:-1])


class ModbusEmulator(InspireEmulator):
    """An Inspire RH56 on Modbus-TCP that a driver finds at `port`.

    Args:
        address: Host and port to listen at; port 0 for a free one.
        number: The hand's unit identifier.
        seed: Seed of the line's noise.
        pace: Rate of the motors' time relative to the host's; the line keeps to the host's.

    Attributes:
        shift: By how much the transaction identifier of a reply is larger than that of the request.
        refusals: Codes of the exceptions that answer the next requests, which are not carried out.
        ignored: Number of frames that were for another hand, or no Modbus.

    Raises:
        UserError: It cannot listen there.
    """

    label = "Inspire RH56 on Modbus-TCP"
    events = f"{InspireEmulator.events}, shift TRANSACTIONS, refuse EXCEPTION, refuse EXCEPTION TIMES"
    line_events = tuple(event for event in InspireEmulator.line_events if event != "echo")

    def __init__(self, address: Address = ("127.0.0.1", 0), number: int = 1, seed: int = 0, pace: float = 1.0) -> None:
        faults = LineFaults(foreign_transaction, seed, framing=9)
        self._connect(number, pace, TcpServer(address, GRACE_S), faults, TCP_TURNAROUND_S, TCP_BYTE_S)
        self.shift = 0
        self.refusals: deque[int] = deque()

    def happen(self, event: str, motor: int | None, *words: str) -> None:
        """See `HandEmulator.happen`."""
        if motor is None and event == "shift" and words:
            self.shift = int(*words)
        elif motor is None and event == "refuse" and len(words) in (1, 2):
            code, times = (int(word) for word in (*words, "1")[:2])
            if not 1 <= code <= 255:
                raise ValueError(code)
            self.refusals.extend([code] * times)
        else:
            super().happen(event, motor, *words)

    def answer(self, data: bytes) -> list[bytes]:
        """Answer the requests in the stream of bytes."""
        self.stream += data
        replies = []
        while len(self.stream) >= 7:
            transaction, protocol, length, unit = struct.unpack_from(">HHHB", self.stream)
            if protocol or not 2 <= length <= 254:  # where the next frame begins, nobody knows
                self.ignored, self.stream = self.ignored + 1, b""
                break
            body, rest = self.stream[7 : 6 + length], self.stream[6 + length :]
            if len(body) < length - 1:
                break
            self.stream = rest
            if unit != self.number:
                self.ignored += 1
                continue

            def answered(transaction: int = transaction, body: bytes = body) -> list[bytes]:
                said = self._said(body)
                shifted = (transaction + self.shift) & 0xFFFF
                return [struct.pack(">HHHB", shifted, 0, 1 + len(said), self.number) + said]

            replies += self.faults.write(answered) if body[0] in (6, 16) else answered()
        return replies

    def _said(self, body: bytes) -> bytes:
        """The reply to a function, or its exception: 1 illegal function, 2 address, 3 value."""
        function, exception = body[0], self.refusals.popleft() if self.refusals else 0
        address, count = struct.unpack(">HH", body[1:5]) if len(body) >= 5 else (0, 0)
        if not exception and function not in (3, 6, 16):
            exception = 1
        if exception:
            return bytes([function | 0x80, exception])
        if function == 3 and len(body) == 5 and 1 <= count <= 125:
            if address in REGISTERS and address + 2 * count - 1 in REGISTERS:
                return bytes([3, 2 * count]) + self._big_endian(address, count)
            return b"\x83\x02"
        if function == 16 and len(body) >= 6 and 1 <= count <= 123 and body[5] == 2 * count == len(body) - 6:
            return body[:5] if self._put(address, body[6:]) else b"\x90\x02"
        if function == 6 and len(body) == 5:
            return body if self._put(address, body[3:]) else bytes([0x86, 3 if address == CLEAR else 2])
        return bytes([function | 0x80, 3])

    def _put(self, address: int, data: bytes) -> bool:
        if address == CLEAR:  # a single byte, in the low one
            return data[:1] == b"\x00" and self._hand.write(address, data[1:])
        return self._hand.write(address, b"".join(data[i : i + 2][::-1] for i in range(0, len(data), 2)))

    def _big_endian(self, address: int, count: int) -> bytes:
        data = bytearray(self._hand.read(address & ~1, 2 * count + 2))
        for first in self._hand.words():
            for i in range(first - (address & ~1), first + 12 - (address & ~1), 2):
                if 0 <= i < len(data):
                    data[i : i + 2] = data[i : i + 2][::-1]
        return bytes(data[address & 1 : (address & 1) + 2 * count])


def foreign_transaction(frame: bytes) -> bytes:
    """Make the reply to another transaction, with other data, out of one."""
    return bytes([frame[0] ^ 0x40, *frame[1:9], *(value ^ 1 for value in frame[9:])])


def emulate(config: HandConfig, listen: Address, seed: int, pace: float) -> HandEmulator[Hand]:
    """Build the emulator of a station's hand on the wire of its `port`."""
    number = getattr(config, "hand_id", None) or 1
    if config.port is not None and config.port.startswith("tcp://"):
        return ModbusEmulator(listen, number, seed, pace)
    return InspireEmulator(number, seed, pace)
