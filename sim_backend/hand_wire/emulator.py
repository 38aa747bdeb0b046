"""An emulated hand at the other end of a driver's wire."""

from __future__ import annotations

import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Generic, Protocol, Self, TypeVar

from toolee_robot.frames import Array
from toolee_robot.sim_backend.hand_wire.hand_time import HandTime
from toolee_robot.sim_backend.hand_wire.line_faults import LineFaults


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

    @property
    def told(self) -> tuple[Any, ...]:
        """What it was told last, to be compared."""

    def run(self) -> None:
        """Let the motors move until now."""

    def hold(self, met_at: float | None) -> None:
        """See `HandEmulator.hold`."""

    def slip(self, way: float) -> None:
        """See `HandEmulator.slip`."""


HandT = TypeVar("HandT", bound=EmulatedHand)
R = TypeVar("R")


class HandEmulator(ABC, Generic[HandT]):
    """A hand that a driver finds at `port`; use it in its `with` block.

    Args:
        hand: The hand.
        faults: Faults of its wire.

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
    thumb: str
    """Name of the motor that bends the thumb."""
    events: str
    """What can happen to it and to nothing else, for people."""
    joints: Callable[[Array], Array]
    """Converts its motors' angles to the positions of the model's joints [rad]."""
    port: str
    time: HandTime

    def __init__(self, hand: HandT, faults: LineFaults) -> None:
        self.faults = faults
        self._hand = hand
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

    def unplug(self) -> None:
        """Pull the cable out for good: whoever has the port open gets an error."""
        if not self._over:
            self._over = True
            os.write(self._wake, b"x")
            self._thread.join()

    @property
    def angles(self) -> tuple[float, ...]:
        """Where the motors are now, in the order of `motors` and the hand's own unit."""
        with self._lock:
            return self._hand.angles

    def tell(self, what: Callable[[HandT], R]) -> R:
        """Do something to the hand while it works.

        Args:
            what: Gets the hand.

        Returns:
            What that returns.
        """
        with self._lock:
            return what(self._hand)

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
    def _run(self) -> None:
        """Speak on the wire until `_over`, of which `_woken` tells who waits; then release the wire."""
