"""What a closed hand holds, judged from its readings; and setpoints for hands that have no speeds of their own."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array

WINDOW_S = 0.1
"""Time over which forces are averaged."""
RELAXED_SHARE = 0.6
"""Share of its force at the grasp below which a finger is closed further."""
PRESS_PERIOD_S = 0.5
"""Shortest time between two commands to close further."""
BACK_DEG, BACK_S = 1.0, 0.06
"""Way and time for which a finger that has collided is told to open before it can close further."""


SaidT = TypeVar("SaidT")


@dataclass(frozen=True)
class Reading(Generic[SaidT]):
    """What a hand said at one time, of its m motors in its own order."""

    stamp: float
    """Time at which it was asked, at the earliest [s]."""
    closures: Array
    """How far each motor is closed, (m,), in a unit of the hand's own; more is further closed."""
    forces: Array
    """Force of each motor's finger on what it touches, (m,), in a unit of the hand's own."""
    said: SaidT
    """What else it said."""
    fault: DeviceError | None = None
    """The gravest fault that the hand reports."""
    trouble: str = ""
    """Everything that is wrong by this reading, for people."""
    temperature: float | None = None
    """Temperature of the hottest part [deg C]; None for a hand that does not tell."""

    def refuse_fault(self) -> None:
        """Raise what is wrong with the hand, if anything is."""
        if self.fault is not None:
            raise self.fault


@dataclass(frozen=True)
class GripRule:
    """What is a grip in one hand. Motors are in the hand's own order, as are the arrays of a `Reading`."""

    fingers: tuple[int, ...]
    """Motors of the fingers."""
    thumb: int
    """Motor that bends the thumb, or of the opposite jaw; a motor that turns the thumb holds nothing."""
    touches: float
    """Force above which a finger counts as touching, in the unit of `Reading.forces`."""
    shut: float
    """Closure from which on a finger presses on the palm, in the unit of `Reading.closures`."""
    slipped: float
    """Way that a finger may close further until the tool counts as slipped, in that unit."""
    unit: str
    """That unit, for people."""
    least: int = 2
    """Fingers that must touch besides the thumb."""


class Grip:
    """Follows the readings of one hand.

    Args:
        rule: What is a grip.

    Attributes:
        holding: Whether the hand holds something: thumb and enough fingers press on it.
        slipped: What has slipped since `begin`, in words; empty for nothing.
    """

    def __init__(self, rule: GripRule) -> None:
        self.holding, self.slipped = False, ""
        self._rule = rule
        self._recent: deque[Reading[Any]] = deque()
        self._grasp: tuple[Array, Array] | None = None
        self._pressed = -np.inf

    def begin(self, reading: Reading[Any]) -> bool:
        """Note the grasp as it is from now on, if the hand holds something; whether it does."""
        self._grasp = (reading.closures.copy(), self._forces()) if self.holding else None
        self.slipped = ""
        return self.holding

    def end(self) -> None:
        """Forget the grasp: the hand is about to open or to close anew."""
        self._grasp, self.slipped = None, ""

    def follow(self, reading: Reading[Any]) -> list[int]:
        """Take the newest reading; return the motors that have to close further to keep up the grip."""
        rule = self._rule
        self._recent.append(reading)
        while reading.stamp - self._recent[0].stamp > WINDOW_S:
            self._recent.popleft()
        forces, closures = self._forces(), reading.closures
        self.holding = self._holds(forces, closures)
        if self._grasp is None:
            return []
        closures_then, forces_then = self._grasp
        held_by = (forces_then > rule.touches) & np.isin(np.arange(len(forces)), [*rule.fingers, rule.thumb])
        # Fingers that press on nothing any more have not slipped when all of them let go at once: the tool is lost,
        # which `holding` says. While the others still hold it, it has turned or slid out of them.
        presses = (reading.forces > rule.touches) | self._holds(reading.forces, closures)
        closed = np.where(held_by & presses, closures - closures_then, 0.0)
        if not self.slipped and closed.max() > rule.slipped:
            self.slipped = f"the grip has slipped: a finger has closed by {closed.max():.0f} {rule.unit}"
        relaxed = held_by & (closures < rule.shut) & (forces < RELAXED_SHARE * forces_then)
        if not relaxed.any() or reading.stamp - self._pressed < PRESS_PERIOD_S:
            return []
        self._pressed = reading.stamp
        return [int(i) for i in np.flatnonzero(relaxed)]

    def _holds(self, forces: Array, closures: Array) -> bool:
        """Whether thumb and fingers press on something that is not the palm."""
        rule = self._rule
        touching = (forces > rule.touches) & (closures < rule.shut)
        return bool(touching[rule.thumb] and touching[list(rule.fingers)].sum() >= rule.least)

    def _forces(self) -> Array:
        return np.asarray(np.mean([reading.forces for reading in self._recent], axis=0))


class Setpoints:
    """Setpoints of the m motors of a hand that goes to a position as fast as it can: slow is a setpoint that is slow.

    Args:
        closures: Where the motors are, (m,) [deg].
        lead: Largest way by which a setpoint is ahead of a motor [deg].

    Attributes:
        at: Where the motors are told to be, (m,) [deg].
    """

    def __init__(self, closures: Array, lead: float) -> None:
        self._lead = lead
        self.at, self._target = closures.copy(), closures.copy()
        self._speed = np.zeros(len(closures))
        self._back_until = np.full(len(closures), -np.inf)
        self._back_to = np.zeros(len(closures))
        self._stamp: float | None = None

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Whether each motor is told to move, (m,)."""
        return np.asarray(np.abs(self.at - self._target) > 1e-9)

    @property
    def way(self) -> Array:
        """Way to each motor's target, positive closing, (m,) [deg]."""
        return self._target - self.at

    def go(self, motors: list[int], targets: Array, speed: Array | float) -> None:
        """Send motors to targets, of all motors (m,) [deg], at a speed or one for each of them [deg/s]."""
        self._target[motors], self._speed[motors] = targets[motors], speed

    def slow(self, motors: NDArray[np.bool_], speed: Array | float) -> None:
        """Let motors that are on their way go on at a speed, or one for each of all (m,) [deg/s]."""
        self._speed = np.where(motors, np.minimum(self._speed, speed), self._speed)

    def hold(self, motors: NDArray[np.bool_], at: Array) -> None:
        """Keep motors at places, of all motors (m,) [deg]."""
        self.at[motors] = self._target[motors] = at[motors]

    def free(self, motors: list[int], closures: Array, towards: float) -> None:
        """Tell fingers to go the other way for a moment, so that they may go on after a collision.

        Args:
            motors: The fingers.
            closures: Where all motors are, (m,) [deg].
            towards: 1 for fingers that shall close further, -1 for those that shall open.
        """
        self._back_until[motors] = (self._stamp or 0.0) + BACK_S
        self._back_to[motors] = closures[motors] - towards * BACK_DEG
        self.at[motors] = closures[motors]

    def advance(self, now: float, closures: Array) -> Array:
        """Move the setpoints to a time [s], with the motors at closures (m,); return what to command, (m,) [deg]."""
        step = 0.0 if self._stamp is None else min(max(now - self._stamp, 0.0), 0.1)
        self._stamp = now
        back = now < self._back_until
        way = np.clip(self._target - self.at, -self._speed * step, self._speed * step)
        moved = np.clip(self.at + way, closures - self._lead, closures + self._lead)
        self.at = np.where(self.moving & ~back, moved, self.at)
        return np.where(back, self._back_to, self.at)
