"""What a closed hand holds, judged from its readings: whether it holds, and whether that slips."""

from __future__ import annotations

from collections import deque

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.hardware.hands.inspire.poller import Reading

FINGERS, THUMB = slice(0, 4), 4
"""Motors of the four fingers, and the one that bends the thumb. The one that turns it holds nothing."""
WINDOW = 0.1
"""Time over which forces are averaged [s]."""
TOUCHES = 100
"""Force above which a finger counts as touching [counts], about 1 N."""
HOLDING_FINGERS = 2
"""Fingers that must touch besides the thumb."""
SHUT = 30
"""Angle below which a finger is shut, and presses on the palm [counts]."""
RELAXED = 0.6
"""Share of its force at the grasp below which a finger is closed further."""
SLIPPED = 40
"""Way that a finger may close further until the tool counts as slipped [counts], some 3 deg."""
PRESS_PERIOD = 0.5
"""Shortest time between two commands to close further [s]."""
_PRESSING = np.arange(6) <= THUMB


class Grip:
    """Follows the readings of one hand.

    Attributes:
        holding: Whether the hand holds something: thumb and two fingers press on it.
        slipped: What has slipped since `begin`, in words; empty for nothing.
    """

    def __init__(self) -> None:
        self.holding, self.slipped = False, ""
        self._recent: deque[Reading] = deque()
        self._grasp: tuple[Array, Array] | None = None
        self._pressed = -np.inf

    def begin(self, reading: Reading) -> bool:
        """Note the grasp as it is from now on, if the hand holds something.

        Args:
            reading: The newest reading.

        Returns:
            Whether it does.
        """
        self._grasp = (np.array(reading.angles), self._forces()) if self.holding else None
        self.slipped = ""
        return self.holding

    def end(self) -> None:
        """Forget the grasp: the hand is about to open or to close anew."""
        self._grasp, self.slipped = None, ""

    def follow(self, reading: Reading) -> list[int]:
        """Take a reading.

        Args:
            reading: The newest one.

        Returns:
            The motors that have to be closed further to keep up the grip.
        """
        self._recent.append(reading)
        while reading.stamp - self._recent[0].stamp > WINDOW:
            self._recent.popleft()
        forces, angles = self._forces(), np.array(reading.angles)
        touching = (forces > TOUCHES) & (angles > SHUT)
        self.holding = bool(touching[THUMB] and touching[FINGERS].sum() >= HOLDING_FINGERS)
        if self._grasp is None:
            return []
        angles_then, forces_then = self._grasp
        held_by = (forces_then > TOUCHES) & _PRESSING
        closed = np.where(held_by, angles_then - angles, 0)
        if not self.slipped and closed.max() > SLIPPED:
            self.slipped = f"the grip has slipped: a finger has closed by {closed.max()} of 1000"
        relaxed = [int(i) for i in np.flatnonzero(held_by & (angles > SHUT) & (forces < RELAXED * forces_then))]
        if not relaxed or reading.stamp - self._pressed < PRESS_PERIOD:
            return []
        self._pressed = reading.stamp
        return relaxed

    def _forces(self) -> Array:
        return np.mean([reading.condition.forces for reading in self._recent], axis=0)
