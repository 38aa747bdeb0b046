"""One motor of the emulated hand: a position controller that pulls on tendons, and a finger that meets something."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

REACTION = 0.02
"""Time from a demand until the motor heeds it [s]: assumed."""
GAIN = 25.0
"""Speed by the way that is left [1/s]: assumed."""
PULL = 40.0
"""Effort by the way that is left [counts/deg]: assumed; the tuning of every hand is its own."""
MOST = 1023.0
"""Largest force demand [counts]: published, the default of `max_force`."""
STIFFNESS = 400.0
"""Effort by the way that a finger has pressed into what it holds [counts/deg]: assumed."""
FRICTION = 12.0
"""Effort of a finger that moves freely [counts]: assumed."""
HOT, COOL = 60.0, 55.0
"""Temperatures at which the firmware halts a motor: published; and at which it works again: assumed [deg C]."""


@dataclass
class Motor:
    """One of the twenty motors.

    Attributes:
        name: Its joint's name, such as "FFJ0".
        low: Lower end of its range [deg].
        high: Upper end [deg].
        fastest: Its fastest speed [deg/s].
        position: Where it is [deg].
        met_at: Position at which its finger meets what is in the hand [deg]; None for nothing.
        jammed: Fault: it cannot move.
        bridge_fault: Fault of its electronics: it is halted.
        temperature: Its temperature [deg C].
        halted: Whether its firmware has halted it.
        velocity: How fast it moves [deg/s].
    """

    name: str
    low: float
    high: float
    fastest: float
    position: float = 0.0
    met_at: float | None = None
    jammed: bool = False
    bridge_fault: bool = False
    temperature: float = 32.0
    halted: bool = False
    velocity: float = 0.0
    _demand: float = 0.0
    _demands: deque[tuple[float, float]] = field(default_factory=deque)

    @property
    def pressed(self) -> float:
        """Effort with which its finger presses on what it holds [counts]."""
        return 0.0 if self.met_at is None else max(0.0, STIFFNESS * (self.position - self.met_at))

    @property
    def effort(self) -> float:
        """What its strain gauges say, without offset and noise [counts]."""
        if self.halted:
            return 0.0
        if self.jammed:
            return min(max(PULL * (self._demand - self.position), -MOST), MOST)
        if self.pressed > 0.0:
            return self.pressed
        return FRICTION * ((self.velocity > 0.0) - (self.velocity < 0.0))

    def demand(self, position: float, now: float) -> None:
        """Take a position demand, which the motor heeds REACTION later.

        Args:
            position: Where it shall be [deg].
            now: Time [s].
        """
        if not self._demands or self._demands[-1][1] != position:
            self._demands.append((now + REACTION, min(max(position, self.low), self.high)))

    def advance(self, now: float, step: float) -> None:
        """Let time pass.

        Args:
            now: Time at the end of the step [s].
            step: Its length [s].
        """
        while self._demands and self._demands[0][0] <= now:
            _, self._demand = self._demands.popleft()
        if self.temperature > HOT:
            self.halted = True
        elif self.temperature <= COOL:
            self.halted = self.bridge_fault
        self.velocity = 0.0
        if not self.jammed:
            self._move(step)

    def _move(self, step: float) -> None:
        target = self.position if self.halted else self._demand
        if self.met_at is not None and max(target, self.position) > self.met_at:
            if self.halted:  # nothing pulls: what it holds pushes it back
                target = self.met_at
            elif target > self.met_at:
                target = (PULL * target + STIFFNESS * self.met_at) / (PULL + STIFFNESS)
                target = min(target, self.met_at + MOST / STIFFNESS)
        way = target - self.position
        self.velocity = min(max(GAIN * way, -self.fastest), self.fastest)
        if abs(way) < 1e-3:
            self.velocity = 0.0
            return
        self.position += max(min(self.velocity * step, abs(way)), -abs(way))
