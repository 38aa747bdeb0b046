"""Driver of the Inspire RH56 hands: on RS-485 (RH56DFX, RH56BFX) with the maker's frames, or on Modbus-TCP (RH56DFTP).

    with InspireHand(hand_model(config.hand), "/dev/ttyUSB0", HostClock()) as hand:   # or "tcp://192.168.11.210:6000"
        hand.open()

Facts are from the maker's "The dexterous hand RH56 series user manual" (V1.0.9), sections 2.2 and 2.4, as public
drivers quote it, and from measurements published by X. Tan, W. Xie and N. Correll (arXiv 2603.08988,
github.com/correlllab/rh56_controller). Those of Modbus-TCP are from "The dexterous hand RH56DFTP user manual"
(PRJ-02-TS-U-010, V1.0.0), section 2.6, as the package inspire_rh56dftp (0.1.0) quotes it: the same registers at the
same addresses, which count bytes; port 6000. Numbers are big-endian, as that package and inspire_sdkpy
(github.com/laurent-19/inspire_hand_ws) read them. Assumed, as inspire_sdkpy takes it: of ERROR, STATUS and TEMP, two
bytes in a register, the first one is the high byte. No code here was ever run on such a hand.

pymodbus's client is not used: it gives a request that it repeats the same transaction identifier, so that a late reply
passes for a new one; it connects again by itself, so that an unplug passes unnoticed; and it refuses the shifted
identifiers of some hands. The tests have pymodbus at the other end of both driver and emulator.
"""

from __future__ import annotations

import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from itertools import cycle

import numpy as np

from toolee_robot.devices.hands import SERIAL, WiredHandKind
from toolee_robot.devices.hands.grip import GripRule, Reading
from toolee_robot.devices.hands.polled import UNPLUGGED, PolledHand
from toolee_robot.devices.hands.ports import Port, PortLine, SerialPort, TcpPort, is_tcp
from toolee_robot.errors import DeviceError, NoAnswerError, ProtocolError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock
from toolee_robot.robots import HandModel
from toolee_robot.robots.hands.inspire import CLOSED, COUNTS, MOTORS, OPEN, joints_of_counts
from toolee_robot.station import HandConfig

BAUD_RATE = 115200
ANSWER_S = 0.04
"""Time for a reply: 6.6 ms were measured for a read of 12 bytes on RS-485, and a USB adapter may keep it back for
16 ms."""
ATTEMPTS = 3
GRACE_S = 0.35
"""Time after which another connection is tried: a hand was seen to drop one that was made less than 0.3 s after the
last one had ended (package inspire_rh56dftp 0.1.0, "Modbus protocol quirks")."""
SHIFTS = (0, -1, 1)
"""By how much a hand may shift the transaction identifier in its replies: one was seen to be off by one (ibid.)."""

CLEAR_ERROR, ANGLE_SET, FORCE_SET, SPEED_SET, ANGLE_ACT, FORCE_ACT = 1004, 1486, 1498, 1522, 1546, 1582
"""Addresses of the first byte. The register of the baud rate is not here: sources disagree on it, so it is never
written."""
ANGLES_LENGTH, CONDITION_LENGTH = 12, 42
"""Bytes of ANGLE_ACT, and from FORCE_ACT to the end of TEMP: forces, currents, errors, states, temperatures."""
STATUSES = {0, 1, 2, 3, 5, 6, 7, 255}
"""Values of STATUS."""
HOTTEST = 150
"""Temperature above which no hand is [deg C]."""
FAULTS = {
    8: ("device.hand_motor", "motor failure", "have the hand repaired, then clear its faults"),
    16: ("device.hand_communication", "internal communication failure", "restart the hand, then clear its faults"),
    2: ("device.hand_over_temperature", "too hot", "let it cool down"),
    4: ("device.hand_over_current", "over current", "see what blocks it, then clear its faults"),
    1: ("device.hand_stall", "stalled", "see what blocks it, then clear its faults"),
}
"""Bit of ERROR -> code of the error, description, remedy; the gravest first."""
NEWTONS = {
    "index": (0.007478, -0.414), "middle": (0.006452, 0.018), "thumb": (0.012547, 0.384),
    "ring": (0.006452, 0.018), "little": (0.006452, 0.018),
}  # fmt: skip
"""Newtons for each count of force, and at 0 counts [N]: index, middle and thumb were measured on one hand between 100
and 1000 counts (Tan, Xie and Correll, 2025); ring and little finger are taken to be like the middle one. The manual
calls a count a gram, which would be 0.0098 N."""
DRIFT = 20
"""Counts of force that are no more than the sensors' drift."""

APPROACH_SPEED, FINISH_SPEED = 300, 25
"""Speeds of the fingers until they touch, and of their pressing [counts; 1000 is the whole range in 0.8 s]. Above 25 a
finger overshoots its force threshold: of one of 500 by 115 % at 250 and by 5 % at 25 (measured)."""
FOLLOW_SPEED = 150
"""Speed with which fingers that hold something follow it when it gives way [counts]: the 40 counts that say that it has
slipped take 0.2 s, at 25 they would take 1.3 s. A finger that meets it again overshoots the grip force by 40 %
(between the two that were measured), which the hand can press."""
TOUCH_FORCE, GRIP_FORCE = 100, 800
"""Force thresholds of the two [counts, about 0.01 N each]."""
OPENED = 50
"""Largest distance from the open hand's angle that counts as open [counts]."""
REACTION_S = 0.07
"""Time from a command until a motor follows it: 66 ms were measured."""
PRESSES = 50
"""Force above which a motor that closes is left to press when the hand is stopped [counts]."""
UNTAKEN = f"it does not take the command to close further (register {ANGLE_SET})"
"""Fault of a hand that answers and lets its grip go slack, for people."""
_BEND, _ROTATION = MOTORS.index("thumb bend"), MOTORS.index("thumb rotation")
STILL = 2
"""Way of a motor that counts as none [counts]; at the slowest speed in use it is 3 within STANDS_S."""
RULE = GripRule(fingers=(0, 1, 2, 3), thumb=_BEND, touches=100.0, shut=COUNTS - 30.0, slipped=40.0, unit="of 1000")
"""A grip: forces above 100 counts, some 1 N; a finger within 30 counts of its end is shut; 40 counts are some 3 deg."""

Find = Callable[[bytes], bytes | None]
"""Finds the reply to one request in all that came; gives what was read, or WRITTEN."""
WRITTEN = b"\x01"
"""The reply to a write that was carried out."""


class InspireLine(PortLine, ABC):
    """The hand at the other end of a wire; one thread may use it.

    Everything of a reply but its data is known from the request. So it is not parsed, it is looked for: garbage,
    replies to other requests, of other hands, and an adapter's echo do not match.
    """

    order: str
    """Order of the bytes of a 16-bit number in what is read and written, as of `struct`."""
    one: bytes
    """What writes 1 to a register of a single byte."""
    look_at: str
    """What a person is to check when it is silent."""

    def __init__(self, port: Port, hand_id: int) -> None:
        super().__init__(port, ANSWER_S)
        self._hand_id = hand_id

    def numbers(self, register: int) -> tuple[int, ...]:
        """Read the six 16-bit numbers of a register."""
        return struct.unpack(f"{self.order}6h", self.read(register, 12))

    def read(self, register: int, count: int) -> bytes:
        """Read bytes from a register on, with some attempts.

        Raises:
            NoAnswerError: The hand does not answer, or the port is gone.
            DeviceError: It refuses.
        """
        for attempt in range(ATTEMPTS):
            if (not attempt or self._recover()) and (found := self.ask(*self._reading(register, count))) is not None:
                return found
        raise self._silent(register)

    def write(self, register: int, data: bytes, *, again: bool = False) -> None:
        """Write bytes, and see them acknowledged, or else read them back, with some attempts.

        Args:
            register: Address of the first.
            data: The bytes; those of a number in `order`.
            again: Whether the hand may hold them already, so that reading them back tells nothing.

        Raises:
            NoAnswerError: The hand does not answer, or the port is gone: whether it has taken the bytes is not known;
                or it answers and has not taken them (`no_answer.hand_write`).
            DeviceError: It refuses them.
        """
        answers = False
        for attempt in range(ATTEMPTS):
            if attempt:
                if not self._recover():
                    continue
                there = self.ask(*self._reading(register, len(data)))
                if there == data and not again:
                    return
                answers |= there is not None
            result = self.ask(*self._writing(register, data))
            if result == WRITTEN:
                return
            if result is not None:
                raise _refused(f"to take {data.hex(' ')} for register {register}")
        if answers:
            raise NoAnswerError(
                f"the hand {self._hand_id} on {self._port.path} answers, but does not take what is written "
                f"(register {register}, {ATTEMPTS} attempts). Power-cycle it, and end every other program that "
                "commands it",
                code="no_answer.hand_write",
            )
        raise self._silent(register)

    @abstractmethod
    def _reading(self, register: int, count: int) -> tuple[bytes, Find]:
        """A request that reads bytes, and what finds its reply."""

    @abstractmethod
    def _writing(self, register: int, data: bytes) -> tuple[bytes, Find]:
        """A request that writes bytes, and what finds its reply."""

    @abstractmethod
    def _recover(self) -> bool:
        """After a request without a reply: make sure that a late one cannot be taken for another; whether it is."""

    def _silent(self, register: int) -> NoAnswerError:
        message = f"no hand {self._hand_id} answers on {self._port.path} (register {register}): {self.look_at}"
        return NoAnswerError(
            f"{message}, its number, and that hand.port is not another device's", code="no_answer.hand_silent"
        )


class SerialLine(InspireLine):
    """The hand on RS-485. A request is `EB 90 ID LEN CMD REGISTER(2) PAYLOAD SUM`, a reply begins with `90 EB` instead.

    A reply that comes too late could be taken for that to the next request of the same register: a USB adapter keeps
    replies back. So after a request without a reply, a short read goes out whose length was not used lately: once that
    is answered, whatever is older has come, and is dropped.
    """

    order, one = "<", b"\x01"
    look_at = "check its power, the two wires of RS-485"

    def __init__(self, port: str, hand_id: int) -> None:
        super().__init__(SerialPort(port, BAUD_RATE, ANSWER_S), hand_id)
        self._barrier_lengths = cycle(range(1, 12))

    def _reading(self, register: int, count: int) -> tuple[bytes, Find]:
        return self._request(0x11, register, bytes((count,)), count)

    def _writing(self, register: int, data: bytes) -> tuple[bytes, Find]:
        return self._request(0x12, register, data, len(WRITTEN))

    def _request(self, command: int, register: int, payload: bytes, count: int) -> tuple[bytes, Find]:
        address = struct.pack("<H", register)
        body = bytes((self._hand_id, 3 + len(payload), command)) + address + payload
        head = b"\x90\xeb" + bytes((self._hand_id, 3 + count, command)) + address
        return b"\xeb\x90" + body + bytes((sum(body) & 0xFF,)), lambda received: serial_reply(received, head, count)

    def _recover(self) -> bool:
        return self.ask(*self._reading(ANGLE_ACT, next(self._barrier_lengths))) is not None


def serial_reply(received: bytes, head: bytes, count: int) -> bytes | None:
    """Find the payload of a reply that begins with a head, and whose sum is right; None while there is none."""
    begin = received.find(head)
    while begin >= 0:
        end = begin + len(head) + count
        # A byte too many shifts the sum, which is right by chance once in 256 times: the frame must end there.
        ends = b"\x90\xeb".startswith(received[end + 1 : end + 3])
        if end < len(received) and ends and received[end] == sum(received[begin + 2 : end]) & 0xFF:
            return received[begin + len(head) : end]
        begin = received.find(head, begin + 1)
    return None


class ModbusLine(InspireLine):
    """The hand on Modbus-TCP, functions 03, 06 and 16 of the MODBUS Application Protocol V1.1b3.

    Every request has a transaction identifier of its own, repeated ones too, so that a late or doubled reply is never
    taken for another. How the hand sends it back is learnt from its first replies, whose lengths tell them apart.
    """

    order, one = ">", b"\x00\x01"
    look_at = "check its power, its cable"

    def __init__(self, port: str, hand_id: int) -> None:
        super().__init__(TcpPort(port, ANSWER_S), hand_id)
        self._transaction = 0
        self._shifts: tuple[int, ...] = SHIFTS
        try:
            try:
                self._learn_shift()
            except NoAnswerError as error:
                if error.code != UNPLUGGED:
                    raise
                self.close()
                time.sleep(GRACE_S)
                self._port = TcpPort(port, ANSWER_S)
                self._learn_shift()
        except NoAnswerError as error:
            self.close()
            if error.code != UNPLUGGED:
                raise
            message = f"the hand at {port} ends every connection at once: does another program use it?"
            raise NoAnswerError(message) from error

    def _learn_shift(self) -> None:
        """Wait for two replies in a row that shift the transaction identifier alike."""
        before: tuple[int, ...] = ()
        for count in range(2, 26, 2):
            self._shifts = SHIFTS
            if self.ask(*self._reading(ANGLE_ACT, count)) is None:
                continue
            if self._shifts == before:
                return
            before = self._shifts
        raise self._silent(ANGLE_ACT)

    def _reading(self, register: int, count: int) -> tuple[bytes, Find]:
        body = struct.pack(">BHH", 3, register, count // 2)
        return self._request(body, bytes((3, count)), count)

    def _writing(self, register: int, data: bytes) -> tuple[bytes, Find]:
        if len(data) == 2:
            body = struct.pack(">BH", 6, register) + data
            return self._request(body, body, 0)
        head = struct.pack(">BHH", 16, register, len(data) // 2)
        return self._request(head + bytes((len(data),)) + data, head, 0)

    def _request(self, body: bytes, head: bytes, count: int) -> tuple[bytes, Find]:
        self._transaction = (self._transaction + 1) & 0xFFFF

        def framed(shift: int, pdu: bytes, further: int = 0) -> bytes:
            transaction = (self._transaction + shift) & 0xFFFF
            return struct.pack(">HHHB", transaction, 0, 1 + len(pdu) + further, self._hand_id) + pdu

        def find(received: bytes) -> bytes | None:
            for shift in self._shifts:
                refused, whole = framed(shift, bytes((body[0] | 0x80,)), 1), framed(shift, head, count)
                code = received.partition(refused)[2][:1]
                if code in (b"\x01", b"\x02", b"\x03"):  # others tell of a hand that is busy: it is asked again
                    raise _refused(f"function {body[0]} at register {body[1:3].hex()} (exception {code[0]})")
                begin = received.find(whole)
                end = begin + len(whole) + count
                if begin >= 0 and len(received) >= end:
                    self._shifts = (shift,)
                    return received[begin + len(whole) : end] or WRITTEN
            return None

        return framed(0, body), find

    def _recover(self) -> bool:
        return True  # the next request has another transaction identifier


def _refused(what: str) -> DeviceError:
    return DeviceError(f"the hand refuses {what}: is it another model?", code="device.hand_refuses")


def condition(stamp: float, angles: tuple[int, ...], data: bytes, order: str) -> Reading[tuple[int, ...]]:
    """Make a reading of what ANGLE_ACT and the 42 bytes from FORCE_ACT on say.

    Args:
        stamp: Time at which they were asked [s].
        angles: The six angles [counts].
        data: The bytes.
        order: Order of the bytes of a number.

    Returns:
        Closures and forces in counts; what the motors' angles are; faults, and the highest temperature.

    Raises:
        ProtocolError: A value is one that no RH56 has.
    """
    numbers = struct.unpack(f"{order}6h6H18B", data)
    forces, errors, statuses, temperatures = numbers[:6], numbers[12:18], numbers[18:24], numbers[24:]
    known = STATUSES.issuperset(statuses) and max(errors) <= sum(FAULTS) and max(temperatures) <= HOTTEST
    if not known or not all(-COUNTS <= angle <= 2 * COUNTS for angle in angles):
        message = f"angles {angles}, errors {errors}, states {statuses}, {temperatures} deg C: is it an RH56?"
        raise ProtocolError(f"the hand reports {message}", code="protocol.hand_values")
    found = [(bit, f"{motor}: {FAULTS[bit][1]}") for motor, bits in zip(MOTORS, errors, strict=True)
             for bit in FAULTS if bits & bit]  # fmt: skip
    trouble, fault = ", ".join(text for _, text in found), None
    if found:
        code, _, remedy = FAULTS[min((bit for bit, _ in found), key=list(FAULTS).index)]
        fault = DeviceError(f"the hand reports a fault ({trouble}): {remedy}; it keeps its grip", code=code)
    closures = COUNTS - np.array(angles, float)
    return Reading(stamp, closures, np.array(forces, float), angles, fault, trouble, float(max(temperatures)))


class InspireHand(PolledHand[InspireLine, tuple[int, ...]]):
    """An Inspire RH56 on a serial port or on Modbus-TCP; use it in its `with` block. Entering it moves nothing.

    Its speeds: the fingers close until they touch, press slowly up to the grip force, and follow faster what gives way
    in them. A grip is kept up: a finger whose force has fallen closes further, and one that has closed by more than a
    little says that the tool has slipped, which `state` reports as a fault until the hand is opened or closed again; so
    is a hand that does not take the command to close further, until it takes one. No fault is cleared by itself:
    `clear_faults` does, after a person has looked.

    `Reading.said` is the motors' angles. Its fingers press with 7 to 13 N: they do not hold a hammer that strikes. Use
    a strap or a mount.

    Args:
        model: The hand: `hand_model(config.hand)`.
        port: The serial port, or `tcp://HOST:PORT` for a hand with Ethernet.
        clock: Clock of the station, the host's.
        hand_id: The hand's number on the line, of Modbus its unit identifier.
    """

    def __init__(self, model: HandModel, port: str, clock: Clock, hand_id: int = 1) -> None:
        super().__init__(model, clock, RULE, STILL)
        self._port, self._hand_id = port, hand_id
        self._target: tuple[int, ...] | None = None
        self._untaken = ""

    def _spread(self, reading: Reading[tuple[int, ...]]) -> tuple[Reading[tuple[int, ...]], list[str]]:
        """The thumb first, then the fingers; the thumb stays before the palm."""
        self._untaken = ""
        self._limit(COUNTS, COUNTS)
        self._move(_with(reading.said, _BEND, OPEN[_BEND]))
        self._until_still(_BEND)
        self._move(OPEN)
        reading = self._until_still()
        at_goal = zip(MOTORS, reading.said, OPEN, strict=True)
        return reading, [name for name, at, goal in at_goal if abs(at - goal) > OPENED]

    def _grasp(self, reading: Reading[tuple[int, ...]]) -> tuple[Reading[tuple[int, ...]], list[str]]:
        """Fingers and thumb together: fast until they touch, then slowly up to the grip's force."""
        self._untaken = ""
        self._limit(TOUCH_FORCE, APPROACH_SPEED)
        if reading.said[_ROTATION] > OPENED:  # the thumb turns before it bends
            self._move(_with(reading.said, _ROTATION, CLOSED[_ROTATION]))
            self._until_still(_ROTATION)
        self._move(CLOSED)
        self._until_still()
        self._limit(GRIP_FORCE, FINISH_SPEED)
        self._move(CLOSED)
        reading = self._until_still()
        if self._grip.holding:
            self._limit(GRIP_FORCE, FOLLOW_SPEED)
        return reading, []  # a finger that does not move is a stall, which the hand reports

    def clear_faults(self) -> None:
        """Clear what is wrong, after a person has looked; heat has to go by itself.

        Raises:
            DeviceError: The hand does not take it.
        """
        self._tell(lambda line: line.write(CLEAR_ERROR, line.one))

    def _limit(self, force: int, speed: int) -> None:
        """Set force thresholds and speeds of all motors but the thumb's rotation, which has the largest [counts]."""
        self._command(FORCE_SET, (*(force,) * 5, COUNTS))
        self._command(SPEED_SET, (*(speed,) * 5, COUNTS))

    def _command(self, register: int, values: tuple[int, ...]) -> None:
        self._tell(lambda line: line.write(register, _packed(values, line)))

    def _move(self, target: tuple[int, ...]) -> None:
        """Set the motors' targets; the hand is known to have them only once it has acknowledged them."""

        def write(line: InspireLine) -> None:
            if not self._stopped.is_set():
                line.write(ANGLE_SET, _packed(target, line))
                self._target = target

        self._tell(write)

    def _connect(self) -> InspireLine:
        return (ModbusLine if is_tcp(self._port) else SerialLine)(self._port, self._hand_id)

    def _read(self, line: InspireLine) -> Reading[tuple[int, ...]]:
        stamp = self._clock.now()
        return condition(stamp, line.numbers(ANGLE_ACT), line.read(FORCE_ACT, CONDITION_LENGTH), line.order)

    def _freeze(self, line: InspireLine) -> None:
        """Set new targets: a speed of zero is no stop, the hand was seen to move on.

        A motor that moves gets the angle as target that it will have reached when it hears of it, so that none turns
        back.
        """
        if self._target is None:
            return
        now = self._recent[-1]
        target, angles = np.array(self._target), np.array(now.said)
        reached = np.clip(angles - self._speeds() * REACTION_S, *np.sort([angles, target], axis=0))
        presses = (target < angles) & (now.forces > PRESSES)
        counts = np.clip(np.where(presses, target, np.rint(reached)), 0, COUNTS)
        frozen = tuple(int(count) for count in counts)
        line.write(ANGLE_SET, _packed(frozen, line))
        self._target = frozen

    def _watch(self, reading: Reading[tuple[int, ...]], line: InspireLine) -> None:
        if self._grip.follow(reading) and self._target is not None:
            try:
                line.write(ANGLE_SET, _packed(self._target, line), again=True)
            except NoAnswerError:
                self._untaken = UNTAKEN  # what is raised here is forgotten with the next reading
                raise
            self._untaken = ""

    def _troubles(self) -> tuple[str, ...]:
        return (self._untaken,)

    def _positions(self, reading: Reading[tuple[int, ...]]) -> Array:
        return joints_of_counts(COUNTS - reading.closures)

    def _newtons(self, reading: Reading[tuple[int, ...]]) -> dict[str, float]:
        counts = dict(zip(("little", "ring", "middle", "index", "thumb"), reading.forces, strict=False))
        return {
            finger: 0.0 if counts[finger] < DRIFT else max(0.0, slope * float(counts[finger]) + at_zero)
            for finger, (slope, at_zero) in NEWTONS.items()
        }


def _with(angles: tuple[int, ...], motor: int, angle: int) -> tuple[int, ...]:
    return (*angles[:motor], angle, *angles[motor + 1 :])


def _packed(values: tuple[int, ...], line: InspireLine) -> bytes:
    return struct.pack(f"{line.order}6h", *values)


def _build(model: HandModel, port: str, config: HandConfig, clock: Clock) -> InspireHand:
    return InspireHand(model, port, clock, config.hand_id or 1)


KIND = WiredHandKind(_build, f"{SERIAL}, or tcp://HOST:PORT of one with Ethernet", "tcp", numbered=True)
