"""One motor of the emulated hand: a finger that moves, collides, may not go on, and gets hot."""

from __future__ import annotations

import random
from collections import deque
from dataclasses import dataclass, field

RANGE = 100.0
"""Way of every motor [deg]."""
REACTION = 0.02
"""Time from a command until the motor heeds it [s]: assumed."""
GAIN = 15.0
"""Speed by the way that is left [1/s]: assumed."""
STIFFNESS = 2.0
"""Force by the way that a finger has pressed into what it holds [N/deg]: assumed."""
COLLISION_FORCE = 10.0
"""Force at which a slow finger counts as having collided [N]: assumed."""
COLLISION_TIME = 0.01
"""Time for which a finger goes on by its momentum [s]: assumed."""
STALL_TIME = 0.05
"""Time for which a blocked motor pushes until it counts as having collided [s]: assumed."""
HOT, COOL = 70.0, 60.0
"""Temperatures at which a motor is shut down, and works again [deg C]: assumed."""
_NEAR = 0.05


@dataclass
class Motor:
    """One of the six motors, from 0 (open) to RANGE (closed) whatever its sign on the wire.

    Attributes:
        fastest: Its fastest speed [deg/s].
        backdrivable: Whether it can be pushed back: such a one is never stopped by a collision.
        position: Where it is [deg].
        met_at: Position at which the finger meets what is in the hand [deg]; None for nothing.
        jammed: Fault: it cannot move.
        temperature: Its temperature [deg C].
        shut_down: Whether it is too hot to move.
        barred: Direction in which it may not go on, 1 closing, -1 opening; 0 for none.
        ratchets: Probability that opening after a grasp is taken for a collision.
        chance: Draws that.
        velocity: How fast it moves, positive closing [deg/s].
    """

    fastest: float
    backdrivable: bool = False
    position: float = 0.0
    met_at: float | None = None
    jammed: bool = False
    temperature: float = 31.0
    shut_down: bool = False
    barred: int = 0
    ratchets: float = 0.1
    chance: random.Random = field(default_factory=random.Random)
    velocity: float = 0.0
    _wanted: tuple[float | None, float] = (None, 0.0)
    _orders: deque[tuple[float, float | None, float]] = field(default_factory=deque)
    _pushing: float = 0.0

    @property
    def force(self) -> float:
        """Force of the finger on what it holds [N]."""
        return 0.0 if self.met_at is None else max(0.0, STIFFNESS * (self.position - self.met_at))

    @property
    def told(self) -> tuple[float | None, float]:
        """Target and speed that it was given last."""
        return self._orders[-1][1:] if self._orders else self._wanted

    @property
    def direction(self) -> int:
        """Where it is told to go: 1 closing, -1 opening, 0 nowhere."""
        target, speed = self._wanted
        way = speed if target is None else target - self.position
        if target is None:
            return (way > 0.0) - (way < 0.0)
        return (way > _NEAR) - (way < -_NEAR)

    @property
    def limited(self) -> bool:
        """Whether it does not do what it is told, to protect itself."""
        return self.shut_down or (self.barred != 0 and self.barred == self.direction)

    def go(self, target: float | None, speed: float, now: float) -> None:
        """Take a command, which the motor heeds REACTION later.

        Args:
            target: Position to go to [deg]; None: move at a speed.
            speed: That speed, positive closing [deg/s].
            now: Time [s].
        """
        self._orders.append((now + REACTION, target, speed))

    def advance(self, now: float, step: float) -> None:
        """Let time pass.

        Args:
            now: Time at the end of the step [s].
            step: Its length [s].
        """
        while self._orders and self._orders[0][0] <= now:
            _, *wanted = self._orders.popleft()
            self._heed((wanted[0], wanted[1] or 0.0))
        if self.temperature >= HOT:
            self.shut_down = True
        elif self.temperature <= COOL:
            self.shut_down = False
        self._move(step)

    def _heed(self, wanted: tuple[float | None, float]) -> None:
        self._wanted = wanted
        if self.barred and self.direction == -self.barred:
            grasped = self.barred == 1 and self.force >= 0.5 * COLLISION_FORCE
            self.barred, self._pushing = 0, 0.0
            if grasped and self.chance.random() < self.ratchets:
                self.barred = -1

    def _move(self, step: float) -> None:
        target, speed = self._wanted
        if target is not None:
            speed = GAIN * (target - self.position) if self.direction else 0.0
        speed = min(max(speed, -self.fastest), self.fastest)
        self.velocity = 0.0
        if self.shut_down or speed == 0.0 or speed * self.barred > 0.0:
            return
        if self.jammed:
            self._pushing += step
            if self._pushing >= STALL_TIME and not self.backdrivable:
                self.barred, self._pushing = (1 if speed > 0.0 else -1), 0.0
            return
        if speed > 0.0 and self.force >= COLLISION_FORCE and self.met_at is not None:
            if not self.backdrivable:
                self.barred = 1
                self.position += COLLISION_TIME * speed
            return
        self.velocity = speed
        way = (
            speed * step
            if target is None
            else min(abs(speed) * step, abs(target - self.position)) * (1 if speed > 0.0 else -1)
        )
        self.position = min(max(self.position + way, 0.0), RANGE)
