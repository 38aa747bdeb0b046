"""Which of the hand's readings are new, which can be true, and when they were taken by this computer's clock."""

from __future__ import annotations

import math

import numpy as np

from toolee_robot.devices.hands.shadow.messages import JointStates
from toolee_robot.devices.hands.wire.counts import LineCounts

FASTEST, SLACK = 5.0, 0.03
"""Velocity of a joint [rad/s], and angle beyond the way that it makes possible [rad], above which a change between two
readings is doubted."""
LONGEST = 1.0
"""Longest time between two readings of which the later one is not doubted [s]."""
DRIFT = 5e-4
"""By how much the two clocks may drift apart [s/s]: ten times what quartz crystals do."""


class Freshness:
    """Admits readings in the order in which they were taken.

    A reading that is no newer than the newest is refused: late, repeated, or of a clock that was set back, which lasts
    until the driver is entered anew. One that the hand cannot have got to since is doubted, until the next one agrees
    with it: so a number that was damaged in a way that JSON does not show is refused, and a finger that was knocked
    aside is believed 8 ms later.

    Args:
        counts: What happened on the wire.
    """

    def __init__(self, counts: LineCounts) -> None:
        self._counts = counts
        self._newest: JointStates | None = None
        self._doubted: JointStates | None = None

    def admit(self, reading: JointStates) -> bool:
        """Take a reading.

        Args:
            reading: The reading.

        Returns:
            Whether it is newer than all others, and can be true.
        """
        if self._newest is not None and reading.stamp <= self._newest.stamp:
            self._counts.late += 1
            return False
        if _follows(self._newest, reading) or _follows(self._doubted, reading):
            self._newest, self._doubted = reading, None
            return True
        self._counts.corrupt += self._newest is not None
        self._doubted = reading
        return False


class HandClock:
    """Converts times of the hand's computer to the station's.

    Nobody sets the two clocks by each other. The reading that came fastest is taken for one that took no time: what the
    fastest way takes is not known, and not counted. Every other reading is as old as it came later than that.
    """

    def __init__(self) -> None:
        self._offset, self._at = math.inf, 0.0

    def station_time(self, stamp: float, received: float) -> float:
        """Convert.

        Args:
            stamp: Time of the hand's computer [s].
            received: Time of the station at which the message was there [s].

        Returns:
            Time of the station, never later than `received` [s].
        """
        drifted = self._offset + DRIFT * max(0.0, received - self._at)
        self._offset, self._at = min(drifted, received - stamp), max(self._at, received)
        return min(stamp + self._offset, received)


def _follows(before: JointStates | None, after: JointStates) -> bool:
    if before is None or not 0.0 < after.stamp - before.stamp <= LONGEST:
        return False
    most = FASTEST * (after.stamp - before.stamp) + SLACK
    return bool(np.abs(after.position - before.position).max() <= most)
