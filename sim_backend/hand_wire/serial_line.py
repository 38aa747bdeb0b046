"""An emulated hand on a pseudo-terminal, in the place of a serial line."""

from __future__ import annotations

import heapq
import os
import select
import threading
import time
import tty
from abc import abstractmethod
from dataclasses import dataclass
from typing import Self

from toolee_robot.sim_backend.hand_wire.emulator import HandEmulator, HandT
from toolee_robot.sim_backend.hand_wire.line_faults import LineFaults


@dataclass(frozen=True)
class Frame:
    """A frame that the hand sends."""

    data: bytes
    """Its bytes."""
    delay: float = 0.0
    """Time that passes before it is sent, beyond that of every reply [s]."""


class SerialEmulator(HandEmulator[HandT]):
    """A hand on a pseudo-terminal; its line is as slow as a real one.

    Args:
        hand: The hand.
        faults: Faults of its line.
        turnaround: Time that the hand takes for a reply [s].
        byte_time: Time of a byte on the line [s].
        pace: Rate of the hand's time relative to the host's; the line keeps to the host's.
    """

    def __init__(self, hand: HandT, faults: LineFaults, turnaround: float, byte_time: float, pace: float = 1.0) -> None:
        super().__init__(hand, faults)
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self.port = os.ttyname(self._theirs)
        self._pace = pace
        self._turnaround, self._byte_time = turnaround, byte_time
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

    @abstractmethod
    def _answer(self, data: bytes) -> list[Frame]:
        """The frames that answer bytes from the line."""

    def _run(self) -> None:
        try:
            self._serve()
        finally:
            os.close(self._ours)
            os.close(self._theirs)

    def _serve(self) -> None:
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
            begin = time.monotonic() + self._turnaround + self._byte_time * len(data)
            if self.faults.echo:
                os.write(self._ours, data)
            with self._lock:
                frames = self._answer(data)
            for frame in frames:
                for piece in self.faults.on_the_way(frame.data):
                    count += 1
                    at = begin + frame.delay / self._pace + piece.delay + self._byte_time * len(piece.data)
                    heapq.heappush(due, (at, count, piece.data))
