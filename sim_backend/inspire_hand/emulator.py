"""The emulated hand on a pseudo-terminal."""

from __future__ import annotations

import heapq
import os
import select
import threading
import time
import tty
from collections.abc import Callable
from typing import Self

from toolee_robot.sim_backend.inspire_hand.hand import Hand
from toolee_robot.sim_backend.inspire_hand.line_faults import LineFaults
from toolee_robot.sim_backend.inspire_hand.requests import RequestParser

TURNAROUND = 0.0041
"""Time that the hand takes for a reply [s]: with the 29 bytes of a read of 12 bytes, the measured 6.6 ms."""
BYTE_TIME = 10.0 / 115200.0
"""Time of a byte on the line [s]."""


class HandEmulator:
    """An Inspire RH56 that a driver finds at `port`; its line is as slow as a real one.

    Args:
        number: The hand's number on the line.
        seed: Seed of the line's noise.
        pace: Rate of the motors' time relative to the host's; the line keeps to the host's.

    Attributes:
        port: Path of the pseudo-terminal.
        faults: Faults of the line.
    """

    def __init__(self, number: int = 1, seed: int = 0, pace: float = 1.0) -> None:
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self.port = os.ttyname(self._theirs)
        self.faults = LineFaults(seed)
        self._pace = pace
        self._hand = Hand(lambda: pace * time.monotonic(), number)
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
    def angles(self) -> tuple[float, ...]:
        """Where the motors are now [counts], little finger first."""
        with self._lock:
            return self._hand.angles

    @property
    def plugged(self) -> bool:
        """Whether the cable is plugged in."""
        return not self._over

    def tell(self, what: Callable[[Hand], object]) -> None:
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

    def _run(self) -> None:
        try:
            self._serve()
        finally:
            os.close(self._ours)
            os.close(self._theirs)

    def _serve(self) -> None:
        parser = RequestParser(self._hand.number)
        due: list[tuple[float, int, bytes]] = []
        count = 0
        while not self._over:
            wait = max(0.0, due[0][0] - time.monotonic()) if due else None
            ready, _, _ = select.select([self._ours, self._woken], [], [], wait)
            while due and due[0][0] <= time.monotonic():
                os.write(self._ours, heapq.heappop(due)[2])
            if self._ours not in ready:
                continue
            data = os.read(self._ours, 4096)
            begin = time.monotonic() + TURNAROUND + BYTE_TIME * len(data)
            if self.faults.echo:
                os.write(self._ours, data)
            for request in parser.take(data):
                with self._lock:
                    frames = self._hand.answer(request)
                    parser.number = self._hand.number
                for frame in frames:
                    for piece in self.faults.on_the_way(frame.data):
                        count += 1
                        at = begin + frame.delay / self._pace + piece.delay + BYTE_TIME * len(piece.data)
                        heapq.heappush(due, (at, count, piece.data))
