"""An emulated hand that answers what comes over a line: over a pseudo-terminal, or a TCP connection."""

from __future__ import annotations

import heapq
import select
import time
from abc import abstractmethod
from dataclasses import dataclass

from toolee_robot.sim_backend.hand_wire.emulator import HandEmulator, HandT
from toolee_robot.sim_backend.hand_wire.line_faults import LineFaults
from toolee_robot.sim_backend.hand_wire.wires import Wire

RUN_PERIOD = 0.05
"""Longest time for which the motors are left [s]: after minutes without a driver, catching up would keep the first one
waiting for its answer."""


@dataclass(frozen=True)
class Frame:
    """A frame that the hand sends."""

    data: bytes
    """Its bytes."""
    delay: float = 0.0
    """Time that passes before it is sent, beyond that of every reply [s]."""


class LineEmulator(HandEmulator[HandT]):
    """A hand that answers what comes over its line, which is as slow as a real one.

    Args:
        hand: The hand.
        wire: Its end of the wire.
        faults: Faults of its line.
        turnaround: Time that the hand takes for a reply [s].
        byte_time: Time of a byte on the line [s].
        pace: Rate of the hand's time relative to the host's; the line keeps to the host's.
    """

    def __init__(
        self, hand: HandT, wire: Wire, faults: LineFaults, turnaround: float, byte_time: float, pace: float = 1.0
    ) -> None:
        super().__init__(hand, faults)
        self._wire, self.port = wire, wire.port
        self._pace = pace
        self._turnaround, self._byte_time = turnaround, byte_time

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
