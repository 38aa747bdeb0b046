"""What every driver of a hand on a wire is: its block, its thread, its motions, its stop."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from toolee_robot.devices.hands.wire.counts import LineCounts
from toolee_robot.devices.hands.wire.grip import Grip, GripRule
from toolee_robot.devices.hands.wire.motion import Motion
from toolee_robot.devices.hands.wire.poller import Poller, ReadingT
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, HandState
from toolee_robot.robots.hands import HandModel
from toolee_robot.types import JointState

MOTION_TIME = 8.0
"""Time for a motion where nobody says another [s]."""
RECENT = 0.1
"""Time over which speeds are taken [s]."""


class HandLine(Protocol):
    """The line to a hand."""

    counts: LineCounts

    def close(self) -> None:
        """Release the port."""


LineT = TypeVar("LineT", bound=HandLine)


class WiredHand(ABC, Generic[LineT, ReadingT]):
    """A `hal.Hand` on a wire; use it in its `with` block. Entering it moves nothing.

    Args:
        model: The hand: `hand_model(config.hand)`.
        clock: Clock of the station, the host's.
        rule: What is a grip.
        still: Way of a motor that counts as none, in the unit of `Reading.closures`.
    """

    def __init__(self, model: HandModel, clock: Clock, rule: GripRule, still: float) -> None:
        self._model, self._clock, self._still = model, clock, still
        self._line: LineT | None = None
        self._poller: Poller[LineT, ReadingT] | None = None
        self._grip = Grip(rule)
        self._recent: tuple[ReadingT, ...] = ()
        self._moving = threading.Lock()
        self._stopped = threading.Event()

    def __enter__(self) -> Self:
        """Open the port and read the hand once.

        Raises:
            NoAnswerError: The port cannot be opened, or no hand answers.
            ProtocolError: What answers is no such hand.
        """
        self._line = self._connect()
        self._poller = Poller(self._line, self._clock, self._read, self._watch)
        try:
            self._poller.start()
        except BaseException:
            self._poller = None
            self._line.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the fingers, which keep what they hold, and release the port."""
        if self._poller is None or self._line is None:
            return
        with suppress(DeviceError):  # a hand that is out of reach cannot be stopped, and keeps its grip
            self.stop()
        self._poller.close()
        self._poller = None
        self._line.close()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the model's joints; a motor moves one or several of them."""
        return self._model.joints

    @property
    def line_counts(self) -> LineCounts:
        """What happened on the line so far."""
        return LineCounts() if self._line is None else self._line.counts

    def reading(self, max_age: float = 0.1) -> ReadingT:
        """Return the newest reading as the hand gave it.

        Args:
            max_age: Its largest age [s].

        Raises:
            StaleDataError: The hand has been silent for longer than `max_age`.
            NoAnswerError: Its port is gone.
            DeviceError: It is closed.
        """
        return self._opened().newest(max_age)

    def stop(self) -> None:
        """Stop the fingers where they are; one that presses goes on pressing. `open` and `close` end with an error."""
        self._stopped.set()
        if self._poller is not None:
            self._poller.run(self._freeze)

    @abstractmethod
    def state(self, max_age: float = 0.1) -> HandState:
        """Return the newest state; it may be asked from any thread at any time."""

    @abstractmethod
    def open(self, timeout: float = MOTION_TIME) -> None:
        """Spread the fingers."""

    @abstractmethod
    def close(self, timeout: float = MOTION_TIME) -> None:
        """Close the fingers until they hold something or are shut."""

    @abstractmethod
    def _connect(self) -> LineT:
        """Open the line."""

    @abstractmethod
    def _read(self, line: LineT, number: int) -> ReadingT:
        """Read the hand; in the thread."""

    @abstractmethod
    def _watch(self, reading: ReadingT, line: LineT) -> None:
        """Judge the grip with every reading, and keep it up; in the thread."""

    @abstractmethod
    def _freeze(self, line: LineT) -> None:
        """Stop the motors; in the thread."""

    def _note(self, reading: ReadingT) -> None:
        """Keep the readings of the last RECENT seconds."""
        self._recent = (*(old for old in self._recent if reading.stamp - old.stamp <= RECENT), reading)

    def _joints(self, reading: ReadingT, convert: Callable[[Array], Array]) -> JointState:
        """Joint state of a reading; `convert` makes joint positions out of closures."""
        q = convert(reading.closures)
        first = next(iter(self._recent), reading)
        duration = max(reading.stamp - first.stamp, RECENT)
        return JointState(q, (q - convert(first.closures)) / duration, reading.stamp)

    def _speeds(self) -> Array:
        """Speeds of the motors' closures over the last RECENT seconds, (m,), per second."""
        first, now = self._recent[0], self._recent[-1]
        return np.asarray((now.closures - first.closures) / max(now.stamp - first.stamp, RECENT))

    def _opened(self) -> Poller[LineT, ReadingT]:
        if self._poller is None:
            raise DeviceError("the hand is closed: use it inside its `with` block", code="device.closed")
        return self._poller

    def _motion(self, timeout: float) -> Motion[LineT, ReadingT]:
        return Motion(self._opened(), self._clock, self._moving, self._stopped, self._freeze, timeout, self._still)
