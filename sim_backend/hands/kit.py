"""What emulators of hands have in common: motors, time, wires with their faults, and events as lines of text.

What a hand says and does is each emulator's own; none of it is the drivers'.
"""

from __future__ import annotations

import heapq
import os
import random
import socket
import threading
import time
import tty
import weakref
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, ClassVar, Generic, Self, TypeVar

from toolee_robot.errors import UserError, words_of
from toolee_robot.frames import Array
from toolee_robot.runtime.clock import readable

Address = tuple[str, int]
"""Host and port."""
STEP_S = 0.002
"""Longest step of the motors."""
RUN_PERIOD_S = 0.05
"""Longest time for which the motors are left: after minutes without a driver, catching up would keep the first one
waiting for its answer."""
_CHUNK = 4096
R = TypeVar("R")
T = TypeVar("T")


class HandTime:
    """The host's time at some rate.

    Args:
        pace: Rate relative to the host's.
    """

    def __init__(self, pace: float) -> None:
        self._pace, self._host = pace, time.monotonic()
        self._now = pace * self._host
        self._lock = threading.Lock()

    def __call__(self) -> float:
        """The time [s]. It never goes back."""
        with self._lock:
            host = time.monotonic()
            now = self._now + self._pace * (host - self._host)
            self._host, self._now = host, now
            return now


class LineFault(StrEnum):
    """What can become of a reply."""

    GARBAGE = "garbage"
    """Noise comes before it."""
    CORRUPT = "corrupt"
    """One of its bytes is another, or a burst of them are."""
    SHORT = "short"
    """Its end is missing."""
    LATE = "late"
    """It comes after the driver has given up on it."""
    DOUBLED = "doubled"
    """It comes twice."""
    FOREIGN = "foreign"
    """The reply of another hand comes before it."""
    LOST = "lost"
    """It does not come."""


class WriteFault(StrEnum):
    """What can become of what is written, while everything that is asked is answered."""

    DEAF = "deaf"
    """It is neither carried out nor acknowledged."""
    UNACKNOWLEDGED = "unacknowledged"
    """It is carried out, and not acknowledged."""


ACKNOWLEDGE = "acknowledge"
"""Event that ends a `WriteFault`."""


class LineFaults:
    """Injects faults into the replies; from any thread.

    Args:
        foreign: Makes a reply of another hand on the line out of one of this hand.
        seed: Seed of the noise, and of faults at random.
        framing: Number of a reply's first bytes in which noise can hit; None for all of them. On TCP, whose checksum
            covers the data, what a hand could send wrong is its framing.
        burst: Bytes of a damaged reply that are others.

    Attributes:
        muted: Whether no reply comes at all.
        writes: What becomes of everything that is written; None: it is carried out and acknowledged.
        echo: Whether the adapter repeats what it was sent, as two-wire ones do.
        rates: Probability of each fault for each reply.
        late_by: By how much late replies are late [s].
    """

    def __init__(
        self, foreign: Callable[[bytes], bytes], seed: int = 0, framing: int | None = None, burst: int = 1
    ) -> None:
        self._foreign, self._framing, self._burst = foreign, framing, burst
        self.muted = self.echo = False
        self.writes: WriteFault | None = None
        self.rates: Mapping[LineFault, float] = {}
        self.late_by = 0.12
        self._random = random.Random(seed)
        self._next: deque[LineFault] = deque()

    def upcoming(self, fault: LineFault, count: int = 1) -> None:
        """Let a fault happen to so many of the next replies."""
        self._next.extend([fault] * count)

    @property
    def pending(self) -> int:
        """Number of injected faults that have not happened yet."""
        return len(self._next)

    def write(self, carry_out: Callable[[], list[T]]) -> list[T]:
        """Let the hand take what is written, as far as `writes` lets it; return what acknowledges it."""
        if self.writes is WriteFault.DEAF:
            return []
        acknowledgement = carry_out()
        return acknowledgement if self.writes is None else []

    def on_the_way(self, frame: bytes) -> list[tuple[bytes, float]]:
        """What arrives of a reply, and the time that passes before it [s]."""
        fault = self._next.popleft() if self._next and not self.muted else self._drawn()
        draw = self._random
        if self.muted or fault is LineFault.LOST:
            return []
        if fault is LineFault.GARBAGE:
            return [(draw.randbytes(draw.randint(1, 30)) + frame, 0.0)]
        if fault is LineFault.CORRUPT:
            end = len(frame[: self._framing])
            at = draw.randrange(max(1, end - self._burst + 1))
            others = bytes(byte ^ draw.randint(1, 255) for byte in frame[at : min(at + self._burst, end)])
            return [(frame[:at] + others + frame[at + len(others) :], 0.0)]
        if fault is LineFault.SHORT:
            return [(frame[: draw.randrange(len(frame))], 0.0)]
        before = [frame] if fault is LineFault.DOUBLED else [self._foreign(frame)] if fault is LineFault.FOREIGN else []
        late = self.late_by if fault is LineFault.LATE else 0.0
        return [(one, late) for one in (*before, frame)]

    def _drawn(self) -> LineFault | None:
        return next((fault for fault, rate in self.rates.items() if self._random.random() < rate), None)


@dataclass
class Motor(ABC):
    """A motor of an emulated hand, in the hand's own unit.

    Attributes:
        position: Where it is.
        target: Where it goes; None: nowhere.
        met_at: Where its finger meets what is in the hand; None for nothing.
        jammed: Fault: it cannot move.
        temperature: Its temperature [deg C].
        orders: Times at which it heeds targets, and the targets.
    """

    reaction: ClassVar[float]
    """Time from a command until the motor heeds it [s]."""
    position: float = 0.0
    target: float | None = None
    met_at: float | None = None
    jammed: bool = False
    temperature: float = 31.0
    orders: deque[tuple[float, float]] = field(default_factory=deque)

    def go(self, target: float, now: float) -> None:
        """Take a target at a time [s], which the motor heeds later."""
        self.orders.append((now + self.reaction, target))

    def advance(self, now: float, step: float) -> None:
        """Let a step of time pass, up to a time [s]."""
        while self.orders and self.orders[0][0] <= now:
            self.heed(self.orders.popleft()[1])
        self.move(now, step)

    def heed(self, target: float) -> None:
        """Begin to go to a target."""
        self.target = target

    @abstractmethod
    def move(self, now: float, step: float) -> None:
        """Move, get hot, stop."""


MotorT = TypeVar("MotorT", bound=Motor)


class EmulatedHand(Generic[MotorT]):
    """The hand at one end of the wire; it does not know of ports. Not safe for several threads.

    Args:
        clock: Returns the time [s].
        motors: Its motors.
        pressing: Which of them close fingers and thumb.
        closing: Direction in which a finger closes: 1 or -1.
    """

    def __init__(
        self, clock: Callable[[], float], motors: Sequence[MotorT], pressing: Sequence[int], closing: float = 1.0
    ) -> None:
        self.motors, self._pressing, self._closing = tuple(motors), pressing, closing
        self._clock, self.now = clock, clock()

    @property
    def angles(self) -> tuple[float, ...]:
        """Where the motors are now, in the hand's own unit."""
        self.run()
        return tuple(motor.position for motor in self.motors)

    @property
    def told(self) -> tuple[Any, ...]:
        """What it was told last, to be compared."""
        return tuple(motor.orders[-1][1] if motor.orders else motor.target for motor in self.motors)

    def hold(self, met_at: float | None) -> None:
        """Put something into the hand that fingers and thumb meet there, or take it out."""
        self.run()
        for index in self._pressing:
            self.motors[index].met_at = met_at

    def slip(self, way: float) -> None:
        """Let what it holds give way by so much."""
        self.run()
        for motor in self.motors:
            if motor.met_at is not None:
                motor.met_at += self._closing * way

    def heat(self, degrees: float) -> None:
        """Let all motors get this hot [deg C]."""
        self.run()
        for motor in self.motors:
            motor.temperature = degrees

    def before_step(self) -> None:
        """What happens at each step besides the motors."""

    def run(self) -> None:
        """Let the motors move until now."""
        end = self._clock()
        while self.now < end:
            step = min(STEP_S, end - self.now)
            self.now += step
            self.before_step()
            for motor in self.motors:
                motor.advance(self.now, step)


HandT = TypeVar("HandT", bound=EmulatedHand[Any])


class HandEmulator(ABC, Generic[HandT]):
    """A hand that a driver finds at `port`; use it in its `with` block.

    Args:
        hand: The hand.
        faults: Faults of its wire.
        clock: The time in which its motors move.

    Attributes:
        port: Where a driver finds it.
        faults: Faults of the wire.
        time: The time in which its motors move.
    """

    line_events: tuple[str, ...] = ("mute", "unmute", "echo", "unplug", "show")
    """What can happen to its line, besides faults of single replies."""
    label: str
    """The hand, for people."""
    motors: tuple[str, ...]
    """Names of its motors."""
    fingers: Mapping[str, tuple[str, ...]]
    """Finger in the hand's `HandModel` -> motors that close it."""
    most: float
    """Largest angle at which something can be met, in the hand's own unit."""
    events: str
    """What can happen to it and to nothing else, for people."""
    joints: Callable[[Array], Array]
    """Converts its motors' angles to the positions of the model's joints [rad]."""
    port: str

    def __init__(self, hand: HandT, faults: LineFaults, clock: HandTime) -> None:
        self.faults, self.time = faults, clock
        self._hand = hand
        self._lock = threading.Lock()
        self._over = False
        self._thread = threading.Thread(target=self._run, name="hand emulator", daemon=True)

    def __enter__(self) -> Self:
        self._woken, self._wake = os.pipe()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()
        os.close(self._wake)
        os.close(self._woken)

    @property
    def plugged(self) -> bool:
        """Whether the cable is plugged in."""
        return not self._over

    def unplug(self) -> None:
        """Pull the cable out for good: whoever has the port open gets an error."""
        if not self._over:
            self._over = True
            os.write(self._wake, b"x")
            self._thread.join()

    @property
    def angles(self) -> tuple[float, ...]:
        """Where the motors are now, in the order of `motors` and the hand's own unit."""
        return self.tell(lambda hand: hand.angles)

    def tell(self, what: Callable[[HandT], R]) -> R:
        """Do something to the hand while it works, and return what that returns."""
        with self._lock:
            return what(self._hand)

    def hold(self, at: float | None) -> None:
        """Put something into the hand that fingers and thumb meet at this angle, in its own unit; None: take it out."""
        self.tell(lambda hand: hand.hold(at))

    def slip(self, way: float) -> None:
        """Let what the hand holds give way: the fingers have to close further by so much, in its own unit."""
        self.tell(lambda hand: hand.slip(way))

    def met(self, finger: str) -> None:
        """Let a finger of the hand's `HandModel` meet something where it is now; others, as the palm, are ignored."""

        def feel(hand: HandT) -> None:
            hand.run()
            for name in self.fingers.get(finger, ()):
                motor = hand.motors[self.motors.index(name)]
                if motor.met_at is None:
                    motor.met_at = motor.position

        self.tell(feel)

    def change(self, motor: int | None, name: str, value: object) -> None:
        """Set an attribute of motors.

        Args:
            motor: Which one; None for all.
            name: The attribute.
            value: Its value.
        """

        def change(hand: HandT) -> None:
            hand.run()
            for changed in hand.motors if motor is None else [hand.motors[motor]]:
                setattr(changed, name, value)

        self.tell(change)

    def happen(self, event: str, motor: int | None, *words: str) -> None:
        """Let one of `events` happen.

        Args:
            event: Its first word.
            motor: The motor that it names; None without one.
            words: What follows.

        Raises:
            ValueError: There is no such event, or a word is wrong.
        """
        if event == "heat" and len(words) == 1:
            self.change(motor, "temperature", float(words[0]))
        elif event in ("jam", "free") and motor is not None and not words:
            self.change(motor, "jammed", event == "jam")
        else:
            raise ValueError(event)

    @abstractmethod
    def _run(self) -> None:
        """Speak on the wire until `_over`, of which `_woken` tells who waits; then release the wire."""


class PseudoTerminal:
    """The hand's end of a serial line."""

    def __init__(self) -> None:
        self._ours, theirs = os.openpty()
        tty.setraw(theirs)
        self.port = os.ttyname(theirs)
        self._ends = weakref.finalize(self, _close, self._ours, theirs)  # one that nobody enters is closed, too

    def sources(self) -> list[int]:
        """File descriptors on which something may arrive."""
        return [self._ours]

    def receive(self, ready: list[int]) -> bytes:
        """Return what has come."""
        return os.read(self._ours, _CHUNK) if self._ours in ready else b""

    def send(self, data: bytes) -> None:
        """Send bytes."""
        os.write(self._ours, data)

    def close(self) -> None:
        """Pull the cable out: whoever has the port open gets an error."""
        self._ends()


def _close(*descriptors: int) -> None:
    for descriptor in descriptors:
        os.close(descriptor)


class TcpServer:
    """A server for one connection at a time; it ends another one at once.

    Args:
        address: Host and port to listen at; port 0 for a free one.
        grace: Time after the end of a connection for which it ends every other one at once, too [s].

    Raises:
        UserError: It cannot listen there.
    """

    def __init__(self, address: Address, grace: float) -> None:
        self._listener = listener(address)
        host, port = self._listener.getsockname()[:2]
        self.port = f"tcp://{host}:{port}"
        self._grace, self._free_from = grace, 0.0
        self._driver: socket.socket | None = None

    def sources(self) -> list[int]:
        """As of a serial line."""
        return [end.fileno() for end in (self._listener, self._driver) if end is not None]

    def receive(self, ready: list[int]) -> bytes | None:
        """Return what has come; None where another driver has come, or the last one has gone."""
        ended = self._driver is not None and self._driver.fileno() in ready  # its end is seen before who comes next
        if self._listener.fileno() in ready and not ended:
            connection, _ = self._listener.accept()
            if self._driver is not None or time.monotonic() < self._free_from:
                connection.close()
                return b""
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.settimeout(1.0)
            self._driver = connection
            return None
        if self._driver is None or self._driver.fileno() not in ready:
            return b""
        try:
            data = self._driver.recv(_CHUNK)
        except OSError:
            data = b""
        if not data:
            self._end()
        return data or None

    def send(self, data: bytes) -> None:
        """Send bytes; where no driver is, they are lost."""
        if self._driver is not None:
            try:
                self._driver.sendall(data)
            except OSError:
                self._end()

    def close(self) -> None:
        """As of a serial line."""
        self._listener.close()
        if self._driver is not None:
            self._driver.close()

    def _end(self) -> None:
        assert self._driver is not None
        self._driver.close()
        self._driver, self._free_from = None, time.monotonic() + self._grace


Wire = PseudoTerminal | TcpServer
"""The hand's end of its wire."""


def listener(address: Address) -> socket.socket:
    """Listen for drivers at host and port; port 0 for a free one.

    Raises:
        UserError: It cannot listen there.
    """
    try:
        return socket.create_server(address, backlog=1)
    except (OSError, OverflowError) as error:
        host, port = address
        raise UserError(f"cannot listen at {host}:{port}: {words_of(error)}", code="user.address") from error


class LineEmulator(HandEmulator[HandT]):
    """A hand that answers what comes over its line, which is as slow as a real one.

    Args:
        hand: The hand.
        wire: Its end of the wire.
        faults: Faults of its line.
        clock: The time in which its motors move.
        turnaround: Time that the hand takes for a reply [s].
        byte_time: Time of a byte on the line [s].

    Attributes:
        stream: What the driver has begun to say.
    """

    def __init__(
        self, hand: HandT, wire: Wire, faults: LineFaults, clock: HandTime, turnaround: float, byte_time: float
    ) -> None:
        super().__init__(hand, faults, clock)
        self._wire, self.port = wire, wire.port
        self._turnaround, self._byte_time, self.stream = turnaround, byte_time, b""

    @abstractmethod
    def answer(self, data: bytes) -> list[bytes]:
        """The frames that answer bytes from the line."""

    def connected(self) -> None:
        """Another driver has come, or the last one has gone: forget what it had begun to say."""
        self.stream = b""

    def _run(self) -> None:
        try:
            self._serve()
        finally:
            self._wire.close()

    def _serve(self) -> None:
        due: list[tuple[float, int, bytes]] = []
        count = 0
        while not self._over:
            wait = min(RUN_PERIOD_S, max(0.0, due[0][0] - time.monotonic())) if due else RUN_PERIOD_S
            ready = readable([*self._wire.sources(), self._woken], wait)
            while due and due[0][0] <= time.monotonic():
                self._wire.send(heapq.heappop(due)[2])
            data = self._wire.receive(ready)
            if data is None:
                self.connected()
                due.clear()
            if not data:
                self.tell(lambda hand: hand.run())
                continue
            begin = time.monotonic() + self._turnaround + self._byte_time * len(data)
            if self.faults.echo:
                self._wire.send(data)
            for frame in self.tell(lambda _, data=data: self.answer(data)):  # type: ignore[misc]
                for piece, delay in self.faults.on_the_way(frame):
                    count += 1
                    heapq.heappush(due, (begin + delay + self._byte_time * len(piece), count, piece))


def happen(emulator: HandEmulator[Any], line: str) -> str:
    """Let something happen to an emulated hand, as a line of text: `heat index 75`, `garbage 3`, `unplug`.

    Args:
        emulator: The hand.
        line: The event.

    Returns:
        What the hand looks like then, for people.

    Raises:
        UserError: There is no such event; the message names those that there are.
    """
    event, *words = line.split()
    try:
        if event in {*LineFault}:
            emulator.faults.upcoming(LineFault(event), int(*words or "1"))
        elif event in emulator.line_events and not words:
            _to_line(emulator, event)
        elif event == "drop" and not words:
            emulator.hold(None)
        elif event in ("handle", "slip"):
            (angle,) = words
            (emulator.hold if event == "handle" else emulator.slip)(float(angle))
        else:
            motor = emulator.motors.index(words.pop(0)) if words and words[0] in emulator.motors else None
            emulator.happen(event, motor, *words)
    except (ValueError, TypeError) as error:
        events = (
            f"handle ANGLE, drop, slip ANGLE, {emulator.events}, {', '.join(emulator.line_events)}, or "
            f"{', '.join(LineFault)} with a number of replies; a MOTOR is one of {', '.join(emulator.motors)}"
        )
        raise UserError(f"{line.strip()!r} cannot happen: give {events}", code="user.hand_event") from error
    if not emulator.plugged:
        return "unplugged"
    return ", ".join(f"{name} {angle:.0f}" for name, angle in zip(emulator.motors, emulator.angles, strict=True))


def _to_line(emulator: HandEmulator[Any], event: str) -> None:
    if event == "unplug":
        emulator.unplug()
    elif event == "echo":
        emulator.faults.echo = True
    elif event in {*WriteFault, ACKNOWLEDGE}:
        emulator.faults.writes = None if event == ACKNOWLEDGE else WriteFault(event)
    elif event != "show":
        emulator.faults.muted = event == "mute"
