"""One motion of the hand: its motors are watched until they stand."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, Self

import numpy as np

from toolee_robot.devices.hands.wire.poller import LineT, Poller, ReadingT
from toolee_robot.errors import DeviceError
from toolee_robot.hal import Clock

STANDS_FOR = 0.1
"""Time without motion after which a motor stands [s]."""
COMMAND_DELAY = 0.1
"""Time after a command within which its motion has begun [s]."""
SILENCE = 0.3
"""Longest time without a reading in a motion [s]."""


class Motion(Generic[LineT, ReadingT]):
    """Context of one motion; there is one at a time.

    Args:
        poller: Reads the hand.
        clock: The station's clock.
        moving: Held while the hand moves.
        stopped: Set when the hand is to stop; cleared as the motion begins.
        freeze: Stops the motors where they are; run by the poller.
        timeout: Time for the whole motion [s].
        still: Way of a motor within STANDS_FOR that counts as none, in the unit of `Reading.closures`.

    Attributes:
        reading: The newest reading.
    """

    def __init__(
        self,
        poller: Poller[LineT, ReadingT],
        clock: Clock,
        moving: threading.Lock,
        stopped: threading.Event,
        freeze: Callable[[LineT], None],
        timeout: float,
        still: float,
    ) -> None:
        self._poller, self._clock, self._moving, self._stopped = poller, clock, moving, stopped
        self._freeze, self._timeout, self._still = freeze, timeout, still
        self._end = clock.now() + timeout
        self.reading: ReadingT = poller.newest(SILENCE)

    def __enter__(self) -> Self:
        """Begin.

        Raises:
            DeviceError: The hand is moving.
        """
        if not self._moving.acquire(blocking=False):
            raise DeviceError("the hand is moving: wait for its motion to end", code="device.busy")
        self._stopped.clear()
        return self

    def __exit__(self, *_: object) -> None:
        self._moving.release()

    def refuse_faults(self) -> None:
        """Raise what is wrong with the hand, if anything is.

        Raises:
            DeviceError: A motor has a fault.
        """
        if self.reading.fault is not None:
            raise self.reading.fault

    def until_still(self, motor: int | None = None, settled: Callable[[ReadingT], bool] = lambda _: True) -> None:
        """Wait until the motors stand, whatever state they report: one that was stuck said that it had arrived.

        Args:
            motor: The only one to wait for; None for all.
            settled: Whether motors that stand have done what they shall, by a reading.

        Raises:
            DeviceError: The motion timed out, or was stopped, or a motor has got a fault.
            StaleDataError: The hand has fallen silent.
        """
        index = slice(None) if motor is None else motor
        had = str(self.reading.fault)
        since, reference = self._clock.now() + COMMAND_DELAY, self.reading.closures
        while True:
            self.reading = self._poller.wait(self.reading.number, SILENCE)
            if str(self.reading.fault) != had:
                self.refuse_faults()
            if self._stopped.is_set():
                raise DeviceError("the hand was stopped; it keeps its grip", code="device.stopped")
            closures = self.reading.closures
            if np.max(np.abs(closures - reference)[index]) > self._still:
                reference, since = closures, max(since, self.reading.stamp)
            elif self.reading.stamp - since >= STANDS_FOR and settled(self.reading):
                return
            if self._clock.now() > self._end:
                self._poller.run(self._freeze)
                message = f"the hand did not finish within {self._timeout:.1f} s; it keeps its position and its grip"
                raise DeviceError(message, code="device.timeout")
