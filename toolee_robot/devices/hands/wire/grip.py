"""What a closed hand holds, judged from its readings: whether it holds, and whether that slips."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from toolee_robot.devices.hands.wire.poller import Reading
from toolee_robot.frames import Array

WINDOW = 0.1
"""Time over which forces are averaged [s]."""
HOLDING_FINGERS = 2
"""Fingers that must touch besides the thumb."""
RELAXED = 0.6
"""Share of its force at the grasp below which a finger is closed further."""
PRESS_PERIOD = 0.5
"""Shortest time between two commands to close further [s]."""


@dataclass(frozen=True)
class GripRule:
    """What is a grip in one hand. Motors are in the hand's own order, as are the arrays of a `Reading`."""

    fingers: tuple[int, ...]
    """Motors of the fingers."""
    thumb: int
    """Motor that bends the thumb; one that turns it holds nothing."""
    touches: float
    """Force above which a finger counts as touching, in the unit of `Reading.forces`."""
    shut: float
    """Closure from which on a finger presses on the palm, in the unit of `Reading.closures`."""
    slipped: float
    """Way that a finger may close further until the tool counts as slipped, in that unit."""
    unit: str
    """That unit, for people."""


class Grip:
    """Follows the readings of one hand.

    Args:
        rule: What is a grip.

    Attributes:
        holding: Whether the hand holds something: thumb and two fingers press on it.
        slipped: What has slipped since `begin`, in words; empty for nothing.
    """

    def __init__(self, rule: GripRule) -> None:
        self.holding, self.slipped = False, ""
        self._rule = rule
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
        self._grasp = (reading.closures.copy(), self._forces()) if self.holding else None
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
        rule = self._rule
        self._recent.append(reading)
        while reading.stamp - self._recent[0].stamp > WINDOW:
            self._recent.popleft()
        forces, closures = self._forces(), reading.closures
        self.holding = self._holds(forces, closures)
        if self._grasp is None:
            return []
        closures_then, forces_then = self._grasp
        pressing = [*rule.fingers, rule.thumb]
        held_by = (forces_then > rule.touches) & np.isin(np.arange(len(forces)), pressing)
        # Fingers that press on nothing any more have not slipped when all of them let go at once: the tool is lost,
        # which `holding` says. While the others still hold it, it has turned or slid out of them.
        presses = (reading.forces > rule.touches) | self._holds(reading.forces, closures)
        closed = np.where(held_by & presses, closures - closures_then, 0.0)
        if not self.slipped and closed.max() > rule.slipped:
            self.slipped = f"the grip has slipped: a finger has closed by {closed.max():.0f} {rule.unit}"
        relaxed = held_by & (closures < rule.shut) & (forces < RELAXED * forces_then)
        if not relaxed.any() or reading.stamp - self._pressed < PRESS_PERIOD:
            return []
        self._pressed = reading.stamp
        return [int(i) for i in np.flatnonzero(relaxed)]

    def _holds(self, forces: Array, closures: Array) -> bool:
        """Whether thumb and fingers press on something that is not the palm."""
        rule = self._rule
        touching = (forces > rule.touches) & (closures < rule.shut)
        return bool(touching[rule.thumb] and touching[list(rule.fingers)].sum() >= HOLDING_FINGERS)

    def _forces(self) -> Array:
        return np.asarray(np.mean([reading.forces for reading in self._recent], axis=0))
