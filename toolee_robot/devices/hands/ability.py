"""Driver of the PSYONIC Ability Hand on a UART or RS-485, with the maker's extended API and PPP byte stuffing.

    with AbilityHand(hand_model(config.hand), "/dev/ttyUSB0", HostClock()) as hand:
        hand.open()

Facts are from the maker's "Ability Hand Interface Control Document" (ICD; github.com/psyonicinc/ability-hand-api, MIT),
sections 3.1 to 3.5, and from frames that the maker recorded for its own tests in the same repository. No code here was
ever run on such a hand.
"""

from __future__ import annotations

import math
import struct
import time
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from toolee_robot.devices.hands import SERIAL, WiredHandKind
from toolee_robot.devices.hands.grip import GripRule, Reading, Setpoints
from toolee_robot.devices.hands.polled import PolledHand
from toolee_robot.devices.hands.ports import PortLine, SerialPort
from toolee_robot.errors import DeviceError, NoAnswerError, ProtocolError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock
from toolee_robot.robots import HandModel
from toolee_robot.robots.hands.ability import CLOSED, MOTORS, OPEN, RANGE, joints_of_closures
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import HandConfig

BAUD_RATE, ADDRESS = 460800, 0x50
"""As delivered (ICD 3.1.2.1)."""
ANSWER_S = 0.03
"""Time for a reply: 2 ms on the wire, and a USB adapter may keep it back for 16 ms."""
ATTEMPTS = 5
"""Attempts to find the hand."""
EXPIRES_S = 0.25
"""Time of the host after which a reply does not come any more."""
REPLY_LENGTH = 72
"""Bytes of a reply, before stuffing."""
POSITION_UNIT = 150.0 / 32767.0
"""Degrees of a position's count (ICD 3.4.1)."""
BEYOND_DEG = (20.0, 140.0)
"""Closures below 0 and above which no motor is."""

APPROACH_SPEED, FINISH_SPEED, OPENING_SPEED = 120.0, 20.0, 240.0
"""Speeds of the fingers until they touch, of their pressing, and of opening [deg/s]."""
FOLLOW_SPEED = 60.0
"""Speed with which fingers that hold something follow it when it gives way, until they touch it again [deg/s]: the 4
deg which say that it has slipped take 0.07 s."""
LEAD_DEG = 12.0
"""Largest way by which a setpoint is ahead of a motor."""
SILENT_S = 0.25
"""Longest time between two commands for which the hand has certainly not left its API mode, which takes 0.3 s (ICD
3.2.4): of the host's time, as the station's may stand still in a simulation; in a rehearsal of the station's."""
OPENED_DEG = 5.0
"""Largest distance from the open hand's closure that counts as open."""
REACTION_S = 0.03
"""Time from a command until a motor follows it: assumed."""
STILL_DEG = 0.5
"""Way of a motor that counts as none; at the slowest speed in use it is 2 within STANDS_S."""
OPEN_STILL_DEG = 15.0
"""Closure below which a finger that the hand has stopped has not closed on anything."""
OPENINGS = 4
"""Attempts to open a finger: going back after a collision may count as another one (ICD 3.2.1)."""
HEAT_S = 0.05
"""Time for which the hand must be limited by heat until it counts as hot."""
TOUCHES = 0.6
"""Force of a finger's pads that counts as touch [N]; the pads are not calibrated."""
LAPSE = "the hand was without a command for too long and may have moved"
"""The fault of a driver that could not run in time, for people."""
_FINGERS, _THUMB, _ROTATOR = [0, 1, 2, 3], MOTORS.index("thumb flexor"), MOTORS.index("thumb rotator")
_ALL = [*_FINGERS, _THUMB, _ROTATOR]
_SIGNS = np.array([1.0, 1.0, 1.0, 1.0, 1.0, -1.0])
RULE = GripRule((0, 1, 2, 3), _THUMB, touches=TOUCHES, shut=CLOSED[0] - 2.0, slipped=4.0, unit="deg")
"""A grip: a finger within 2 deg of its end is shut, one that has closed by 4 deg says that the tool has slipped."""


class Header(IntEnum):
    """Headers of the commands in use: the low digit is the variant of the reply."""

    POSITION_CURRENT = 0x10
    POSITION_VELOCITY = 0x11
    READ_CURRENT = 0xA0
    """Changes nothing, and does not enter the API mode; the reply is as of POSITION_CURRENT."""
    READ_VELOCITY = 0xA1


def command(address: int, header: Header, degrees: Array | None = None) -> bytes:
    """Build a command: its bytes sum up to 0 modulo 256 (ICD 3.4.8), between flags, with what looks like one escaped.

    Args:
        address: The hand's address.
        header: Which command.
        degrees: Positions of the six motors in the maker's order and signs, (6,) [deg]; None for one that only reads.

    Returns:
        The bytes for the line.
    """
    counts = b"" if degrees is None else struct.pack("<6h", *np.rint(degrees / POSITION_UNIT).astype(int))
    body = bytes((address, header)) + counts
    frame = body + bytes((-sum(body) & 0xFF,))
    return b"\x7e" + frame.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e") + b"\x7e"


@dataclass(frozen=True)
class Reply:
    """What the hand says in a reply."""

    header: int
    """Of the command that it answers."""
    positions: Array
    """Of the six motors, as the maker counts them, (6,) [deg]."""
    touch: Array
    """The 30 pads, six of each finger, (30,) [counts of 0 to 4095]."""
    limited: NDArray[np.bool_]
    """Whether each motor protects itself, (6,) (ICD 3.4.7): after a collision, or of heat."""


def decode(frame: bytes) -> Reply:
    """Decode an undamaged reply.

    Raises:
        ProtocolError: It says what no Ability Hand says.
    """
    positions = np.array(struct.unpack_from("<12h", frame, 1)[::2]) * POSITION_UNIT
    closures = _SIGNS * positions
    if closures.min() < -BEYOND_DEG[0] or closures.max() > BEYOND_DEG[1]:
        message = f"the hand says that its motors are at {positions.round()} deg: is it an Ability Hand?"
        raise ProtocolError(message, code="protocol.hand_values")
    bits = int.from_bytes(frame[25:70], "little")  # 12 bits a pad, the first in the lowest bits
    touch = np.array([bits >> 12 * pad & 0xFFF for pad in range(30)])
    return Reply(frame[0], positions, touch, np.array([bool(frame[70] >> motor & 1) for motor in range(6)]))


class FrameReader:
    """Finds the undamaged replies in the bytes of the line: a flag always ends one and begins the next.

    Attributes:
        corrupt: Number of frames of a reply's length whose sum was wrong.
    """

    def __init__(self) -> None:
        self.corrupt = 0
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Take further bytes; return the replies that they complete, without flags and escapes."""
        *frames, rest = (self._rest + data).split(b"\x7e")
        self._rest = rest[-2 * REPLY_LENGTH :]
        plain = [frame.replace(b"\x7d\x5e", b"\x7e").replace(b"\x7d\x5d", b"\x7d") for frame in frames]
        whole = [frame for frame in plain if len(frame) == REPLY_LENGTH]
        good = [frame for frame in whole if not sum(frame) & 0xFF]
        self.corrupt += len(whole) - len(good)
        return good


class AbilityLine(PortLine):
    """The hand on a serial port; one thread may use it.

    Every command is answered, and the answer is its acknowledgement: a damaged command gets none. A reply does not say
    which command it answers, but its kind, and there are two kinds of commands, used in turn. While a reply to one kind
    may still come, the other kind is used; if both may, a reply counts as the one to the oldest command.
    """

    def __init__(self, port: str, address: int, clock: Clock) -> None:
        super().__init__(SerialPort(port, BAUD_RATE, ANSWER_S), ANSWER_S)
        self._address, self._clock = address, clock
        self._reader, self._newest = FrameReader(), -math.inf
        self._doubted: dict[Header, tuple[float, float]] = {}
        self._turn = False

    def find(self) -> tuple[float, Reply]:
        """Ask whether the hand is there, with some attempts; as `exchange`."""
        for _ in range(ATTEMPTS - 1):
            try:
                return self.exchange(None)
            except NoAnswerError as error:
                if error.code != "no_answer.hand_silent":
                    raise
        return self.exchange(None)

    def exchange(self, degrees: Array | None) -> tuple[float, Reply]:
        """Send a command, positions (6,) [deg] or only a question, and wait for its reply.

        Returns:
            Time at which the command that is answered went out at the earliest [s], and the reply.

        Raises:
            NoAnswerError: None came in time, or the port is gone.
            ProtocolError: It says what no Ability Hand says.
        """
        sent, now = time.monotonic(), self._clock.now()
        header = self._kind(degrees is None, sent)
        stamp = self._doubted.get(header, (sent, now))[1]
        self.counts.requests += 1
        self._port.drop_received()
        if self._port.send(command(self._address, header, degrees)):
            while time.monotonic() < sent + ANSWER_S:
                frames = self._reader.feed(self._port.receive())
                self.counts.corrupt = self._reader.corrupt
                found = next((frame for frame in frames if frame[0] == header), None)
                if found is not None and stamp >= self._newest:
                    self._newest = stamp
                    return stamp, decode(found)
        self._doubted[header] = (sent, stamp)
        self.counts.unanswered += 1
        raise NoAnswerError(
            f"no hand {self._address} answers on {self._port.path}. Check its power and its two wires. Its UART and "
            "both stuffings must be on (We16, We46, We47). Check its address, and that hand.port is not another "
            "device's",
            code="no_answer.hand_silent",
        )

    def _kind(self, reads: bool, sent: float) -> Header:
        """The kind of the next command: the two in turn, but for one to which a reply may still come."""
        self._doubted = {kind: since for kind, since in self._doubted.items() if sent - since[0] <= EXPIRES_S}
        kinds = [Header.READ_CURRENT, Header.READ_VELOCITY]
        if not reads:
            kinds = [Header.POSITION_CURRENT, Header.POSITION_VELOCITY]
        self._turn = not self._turn
        first, second = kinds if self._turn else kinds[::-1]
        return second if first in self._doubted and second not in self._doubted else first


class Touch:
    """Forces of the fingers since the hand was asked first; pads at rest say something, each another number.

    A pad's rest is the least that it has said so far: one that was pressed from the beginning says too little until it
    was free once.
    """

    def __init__(self) -> None:
        self._rest: Array | None = None

    def newtons(self, counts: Array) -> Array:
        """Convert what the pads say, (30,) [counts], to the sum of the forces on each finger's pads, (5,) [N].

        The factor is the maker's placeholder, it has not calibrated the pads (ICD 3.4.6).
        """
        volts = counts * 3.3 / 4096.0
        conductance = volts / (33000.0 + 10000.0 * volts)
        self._rest = conductance if self._rest is None else np.minimum(self._rest, conductance)
        force: Array = 121591.0 * (conductance - self._rest)
        return force.reshape(5, 6).sum(axis=1)


class AbilityHand(PolledHand[AbilityLine, NDArray[np.bool_]]):
    """A PSYONIC Ability Hand on a serial port; use it in its `with` block. Entering it moves nothing.

    Its first motion takes the hand into its API mode; from then on a command goes out every 10 ms, and the block keeps
    it up. 0.3 s after the last one the hand leaves that mode, **possibly with motion**: when the block ends, when the
    program dies, when the cable is pulled, whatever holds the tool then is not this driver.

    Its two speeds: the fingers close until they touch, then press slowly until the hand itself stops them, and the
    thumb after them. The drives hold without power what they have gripped. A grip is kept up: a finger whose force has
    fallen closes further, which takes a moment of opening, and one that has closed by more than a little says that the
    tool has slipped, which `state` reports as a fault until the hand is opened or closed again.

    `Reading.said` is whether each motor protects itself. The maker publishes no force of the grip: do not let it hold a
    hammer that strikes without a strap or a mount.

    Args:
        model: The hand: `hand_model(config.hand)`.
        port: The serial port.
        clock: Clock of the station, the host's.
        hand_id: The hand's address on the line.
    """

    blocked = "something blocks the hand, or it is too hot"

    def __init__(self, model: HandModel, port: str, clock: Clock, hand_id: int = ADDRESS) -> None:
        super().__init__(model, clock, RULE, STILL_DEG)
        self._port, self._address = port, hand_id
        self._setpoints: Setpoints | None = None
        self._silent_most = clock.to_wall_time(SILENT_S) if isinstance(clock, HostClock) else SILENT_S

    def _spread(self, reading: Reading[NDArray[np.bool_]]) -> tuple[Reading[NDArray[np.bool_]], list[str]]:
        """The thumb first, then the fingers; the thumb stays before the palm."""
        self._lapsed = False
        for motors in ([_THUMB], _ALL):
            self._go(motors, OPEN, OPENING_SPEED)
            self._free_what_is_stuck(self._until_still(), motors)
        reading = self.reading(1.0)
        return reading, [MOTORS[motor] for motor in _short(reading, _ALL)]

    def _grasp(self, reading: Reading[NDArray[np.bool_]]) -> tuple[Reading[NDArray[np.bool_]], list[str]]:
        """The fingers first, then the thumb."""
        self._lapsed = False
        if abs(reading.closures[_ROTATOR] - CLOSED[_ROTATOR]) > OPENED_DEG:  # the thumb turns before it bends
            self._go([_ROTATOR], CLOSED, OPENING_SPEED)
            self._until_still(_ROTATOR)
        for motors in (_FINGERS, [_THUMB]):
            self._go(motors, CLOSED, APPROACH_SPEED)
            reading = self._until_still()
        stuck = reading.said & (reading.closures < OPEN_STILL_DEG) & (reading.forces <= TOUCHES)
        return reading, [MOTORS[motor] for motor in (*_FINGERS, _THUMB) if stuck[motor]]

    def _go(self, motors: list[int], targets: tuple[float, ...], speed: float) -> None:
        """Send motors to targets, unless the hand is to stop."""

        def go(_line: AbilityLine) -> None:
            if not self._stopped.is_set():
                if self._setpoints is None:
                    self._setpoints = Setpoints(self._recent[-1].closures, LEAD_DEG)
                self._setpoints.go(motors, np.array(targets), speed)

        self._tell(go)

    def _free_what_is_stuck(self, reading: Reading[NDArray[np.bool_]], motors: list[int]) -> None:
        """A finger that should open and does not may be told so again after it was told to close (ICD 3.2.1)."""
        for _ in range(OPENINGS):
            stuck = [motor for motor in _short(reading, motors) if reading.said[motor]]
            if not stuck:
                return

            def free(_line: AbilityLine, stuck: list[int] = stuck) -> None:
                if self._setpoints is not None:
                    self._setpoints.free(stuck, self._recent[-1].closures, -1.0)

            self._tell(free)
            self._go(motors, OPEN, OPENING_SPEED)
            reading = self._until_still()

    def _connect(self) -> AbilityLine:
        self._touch, self._lapsed = Touch(), False
        self._setpoints = None
        self._asked, self._cool_at = -math.inf, math.inf
        return AbilityLine(self._port, self._address, self._clock)

    def _read(self, line: AbilityLine) -> Reading[NDArray[np.bool_]]:
        """Send the next command, and take the reply to it: in the poller's thread, silent or not."""
        host = time.monotonic()
        if self._setpoints is not None and host - self._asked > self._silent_most:
            # The hand may have left its API mode and moved: it stays where it is now.
            self._lapsed, self._setpoints = True, None
        self._asked = host
        degrees = None
        if self._setpoints is not None:
            degrees = _SIGNS * self._setpoints.advance(self._clock.now(), self._recent[-1].closures)
        stamp, reply = line.exchange(degrees) if self.readings else line.find()
        if not self.readings and not reply.touch.any():
            raise DeviceError(
                "the hand reports no touch pads: it has none, or they are broken, so it cannot sense a tool. Use "
                "one with pads, or a mount",
                code="device.hand_no_pads",
            )
        closures = _SIGNS * reply.positions
        if self._setpoints is None and self._lapsed:
            self._setpoints = Setpoints(closures, LEAD_DEG)
        forces = np.append(self._touch.newtons(reply.touch), 0.0)
        hot = self._heat(stamp, bool(reply.limited[_ROTATOR]))
        return Reading(stamp, closures, forces, reply.limited, hot, "" if hot is None else "too hot")

    def _heat(self, stamp: float, limited: bool) -> DeviceError | None:
        """The error of a palm that is too hot, which limits every motor (ICD 3.2.3).

        Collisions have the same bits, but none ever limits the rotator (ICD 3.2.1). One finger that is too hot cannot
        be told from one that grips; it keeps its grip, and is found when it is told to open or to close and does not.
        """
        self._cool_at = min(self._cool_at, stamp) if limited else math.inf
        if stamp - self._cool_at < HEAT_S:
            return None
        message = "the hand protects its motors from heat: let it cool down; it keeps its grip"
        return DeviceError(message, code="device.hand_over_temperature")

    def _watch(self, reading: Reading[NDArray[np.bool_]], line: AbilityLine) -> None:  # noqa: ARG002
        """Slow what touches, let go of nothing, judge the grip."""
        relaxed = self._grip.follow(reading)
        if self._setpoints is None:
            return
        closing = self._setpoints.moving & (self._setpoints.way > 0.0)
        self._setpoints.slow(closing & (reading.forces > TOUCHES), FINISH_SPEED)
        if relaxed:
            self._setpoints.free(relaxed, reading.closures, 1.0)
            self._setpoints.go(relaxed, np.array(CLOSED), FOLLOW_SPEED)

    def _freeze(self, line: AbilityLine) -> None:  # noqa: ARG002
        """Let every motor stay where it will have stopped; what presses keeps its force without being told."""
        if self._setpoints is not None:
            reached = self._recent[-1].closures + self._speeds() * REACTION_S
            self._setpoints.hold(np.ones(len(MOTORS), bool), np.clip(reached, 0.0, RANGE))

    def _troubles(self) -> tuple[str, ...]:
        return (LAPSE,) if self._lapsed else ()

    def _positions(self, reading: Reading[NDArray[np.bool_]]) -> Array:
        return joints_of_closures(reading.closures)

    def _newtons(self, reading: Reading[NDArray[np.bool_]]) -> dict[str, float]:
        return dict(zip((*MOTORS[:4], "thumb"), map(float, reading.forces), strict=False))


def _short(reading: Reading[NDArray[np.bool_]], motors: list[int]) -> list[int]:
    return [motor for motor in motors if abs(reading.closures[motor] - OPEN[motor]) > OPENED_DEG]


def _build(model: HandModel, port: str, config: HandConfig, clock: Clock) -> AbilityHand:
    return AbilityHand(model, port, clock, config.hand_id or ADDRESS)


KIND = WiredHandKind(_build, SERIAL, numbered=True)
