"""An emulated hand at one end of a wire."""

from __future__ import annotations

import heapq
import os
import select
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

from toolee_robot.sim_backend.hand_wire.line_faults import LineFaults
from toolee_robot.sim_backend.hand_wire.wires import Wire


class Motor(Protocol):
    """A motor of an emulated hand.

    Attributes:
        position: Where it is, in the hand's own unit.
        met_at: Where its finger meets what is in the hand; None for nothing.
    """

    position: float
    met_at: float | None


class EmulatedHand(Protocol):
    """A hand at one end of the line."""

    @property
    def motors(self) -> Sequence[Motor]:
        """Its motors."""

    @property
    def angles(self) -> tuple[float, ...]:
        """Where the motors are now, in the hand's own unit."""

    def run(self) -> None:
        """Let the motors move until now."""

    def hold(self, met_at: float | None) -> None:
        """See `HandEmulator.hold`."""

    def slip(self, way: float) -> None:
        """See `HandEmulator.slip`."""


RUN_PERIOD = 0.05
"""Longest time for which the motors are left [s]: after minutes without a driver, catching up would keep the first one
waiting for its answer."""

HandT = TypeVar("HandT", bound=EmulatedHand)


@dataclass(frozen=True)
class Frame:
    """A frame that the hand sends."""

    data: bytes
    """Its bytes."""
    delay: float = 0.0
    """Time that passes before it is sent, beyond that of every reply [s]."""


class HandEmulator(ABC, Generic[HandT]):
    """A hand that a driver finds at `port`; its line is as slow as a real one.

    Args:
        hand: The hand.
        wire: Its end of the wire.
        faults: Faults of its line.
        turnaround: Time that the hand takes for a reply [s].
        byte_time: Time of a byte on the line [s].
        pace: Rate of the hand's time relative to the host's; the line keeps to the host's.

    Attributes:
        port: What a driver opens.
        faults: Faults of the line.
    """

    line_events: tuple[str, ...] = ("mute", "unmute", "echo", "unplug", "show")
    """What can happen to its line, besides faults of single replies."""
    label: str
    """The hand, for people."""
    motors: tuple[str, ...]
    """Names of its motors."""
    thumb: str
    """Name of the motor that bends the thumb."""
    events: str
    """What can happen to it and to nothing else, for people."""

    def __init__(
        self, hand: HandT, wire: Wire, faults: LineFaults, turnaround: float, byte_time: float, pace: float = 1.0
    ) -> None:
        self._wire, self.port = wire, wire.port
        self.faults = faults
        self._hand, self._pace = hand, pace
        self._turnaround, self._byte_time = turnaround, byte_time
        self._lock = threading.Lock()
        self._wake, self._woken = os.pipe()[::-1]
        self._over = False
        self._thread = threading.Thread(target=self._run, name="hand emulator", daemon=True)

    def __enter__(self) -> Self:
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

    @property
    def angles(self) -> tuple[float, ...]:
        """Where the motors are now, in the order of `motors` and the hand's own unit."""
        with self._lock:
            return self._hand.angles

    def tell(self, what: Callable[[HandT], object]) -> None:
        """Do something to the hand while it works.

        Args:
            what: Gets the hand.
        """
        with self._lock:
            what(self._hand)

    def unplug(self) -> None:
        """Pull the cable out for good: whoever has the port open gets an error."""
        if not self._over:
            self._over = True
            os.write(self._wake, b"x")
            self._thread.join()

    def hold(self, at: float | None) -> None:
        """Put something into the hand that fingers and thumb meet at this angle, in the hand's own unit.

        Args:
            at: The angle; None: take it out.
        """
        self.tell(lambda hand: hand.hold(at))

    def slip(self, way: float) -> None:
        """Let what the hand holds give way.

        Args:
            way: By how much further the fingers have to close to meet it, in the hand's own unit.
        """
        self.tell(lambda hand: hand.slip(way))

    def met(self, finger: str) -> None:
        """Let a finger meet something where it is now; one that the hand does not have, such as the palm, is ignored.

        Args:
            finger: Its name in the hand's `HandModel`.
        """
        name = self.thumb if finger == "thumb" else finger
        if name not in self.motors:
            return

        def feel(hand: HandT) -> None:
            hand.run()
            motor = hand.motors[self.motors.index(name)]
            if motor.met_at is None:
                motor.met_at = motor.position

        self.tell(feel)

    @abstractmethod
    def happen(self, event: str, motor: int | None, *words: str) -> None:
        """Let one of `events` happen.

        Args:
            event: Its first word.
            motor: The motor that it names; None without one.
            words: What follows.

        Raises:
            ValueError: There is no such event, or a word is wrong.
            TypeError: There are too many words, or too few.
        """

    @abstractmethod
    def _answer(self, data: bytes) -> list[Frame]:
        """The frames that answer bytes from the line."""

    def _connected(self) -> None:
        """Another driver has come, or the last one has gone: forget what it had begun to say."""

    def _run(self) -> None:
        try:
            self._serve()
        finally:
            self._wire.close()

    def _serve(self) -> None:
        due: list[tuple[float, int, bytes]] = []
        count = 0
        while not self._over:
            wait = min(RUN_PERIOD, max(0.0, due[0][0] - time.monotonic())) if due else RUN_PERIOD
            ready, _, _ = select.select([*self._wire.sources(), self._woken], [], [], wait)
            while due and due[0][0] <= time.monotonic():
                self._wire.send(heapq.heappop(due)[2])
            data = self._wire.receive(ready)
            if data is None:
                self._connected()
                due.clear()
            if not data:
                with self._lock:
                    self._hand.run()
                continue
            begin = time.monotonic() + self._turnaround + self._byte_time * len(data)
            if self.faults.echo:
                self._wire.send(data)
            with self._lock:
                frames = self._answer(data)
            for frame in frames:
                for piece in self.faults.on_the_way(frame.data):
                    count += 1
                    at = begin + frame.delay / self._pace + piece.delay + self._byte_time * len(piece.data)
                    heapq.heappush(due, (at, count, piece.data))
