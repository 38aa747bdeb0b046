"""Every reading of the force at the flange, none left out.

The wheel keeps the newest of what has come and drops the rest: of two readings that a busy network delivers at once it
shows one, and a blow may be in the other. So forces come over a connection of their own, which only reads, and on
which they wait in the order in which they were sent.
"""

from __future__ import annotations

import time
from collections.abc import Iterable

import numpy as np

from toolee_robot.errors import NoAnswerError, NotReadyError, ProtocolError
from toolee_robot.frames import Array
from toolee_robot.hardware.rtde_reader import RtdeReader, RtdeSample
from toolee_robot.host_clock import HostClock

ABSURD = 1e4
"""[N, Nm] No robot reads so much, nor what is not a number."""

# The controller's base is our base_link turned by pi about z: forces and torques change sign in x and y.
_TURN = np.array([-1.0, -1.0, 1.0, -1.0, -1.0, 1.0])


class WrenchStream:
    """newest: (6,) [N, Nm] at the flange, in `base`; seen: when it came [s]. lost: True for good once the connection is
    gone. sane: False for good once data made no sense; they are never taken in."""

    def __init__(self, host: str, rate: float, timeout: float, clock: HostClock) -> None:
        """Connect, and wait for the first reading; timeout [s] of the wall. Raises NoAnswerError, ProtocolError, and
        NotReadyError for a controller that does not report forces."""
        deadline = time.monotonic() + timeout
        self._clock, self._timestamp = clock, -np.inf
        self._unread: list[Array] = []
        self.newest, self.seen = np.zeros(6), clock.now()
        self.lost, self.sane = False, True
        self._reader = RtdeReader.connect(host, deadline)
        if self._reader.subscribe(["timestamp", "actual_TCP_force"], rate, deadline):
            raise NotReadyError("the controller does not report the force at the flange: update PolyScope")
        self._take([self._reader.read(deadline)])

    def read(self) -> None:
        """Take in what has come. Never waits."""
        if self.lost or not self.sane:
            return
        try:
            self._take(self._reader.arrived())
        except ProtocolError:
            self.sane = False
        except NoAnswerError:
            self.lost = True

    def unread(self) -> list[Array]:
        """Those that have come since this was last asked, (6,) each, the oldest first."""
        unread, self._unread = self._unread, []
        return unread

    def _take(self, samples: Iterable[RtdeSample]) -> None:
        for sample in samples:
            timestamp, wrench = sample.values["timestamp"], np.array(sample.values["actual_TCP_force"])
            if timestamp == self._timestamp:
                continue
            # The controller's clock only goes forward. NaN fails every comparison.
            if not (isinstance(timestamp, float) and self._timestamp < timestamp < np.inf):
                raise ProtocolError("the robot's time goes back")
            if not (wrench.shape == (6,) and np.all(np.abs(wrench) < ABSURD)):
                raise ProtocolError("the robot's forces are no forces")
            self._timestamp, self.newest, self.seen = timestamp, wrench * _TURN, self._clock.now()
            self._unread.append(self.newest)
