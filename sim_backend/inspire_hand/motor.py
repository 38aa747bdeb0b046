"""One motor of the emulated hand: a finger that moves, meets something, stops, stalls and gets hot."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

RANGE = 1000.0
FULL_SPEED = RANGE / 0.8
"""Counts a second at speed 1000: published."""
REACTION = 0.066
"""Time from a command, or from a force, until the motor heeds it [s]: measured."""
STIFFNESS = 20.0
"""Force by the way that a finger has pressed into what it holds [counts of each]: assumed, so that the threshold is
overshot by about what was measured."""
STALL_TIME = 0.5
"""Time for which a motor pushes without moving until it counts as stalled [s]: assumed."""
HOT, COOL = 70.0, 60.0
"""Temperatures at which a motor stops, and at which it works again [deg C]: assumed."""
STALLED, OVERHEATED, OVER_CURRENT = 1, 2, 4
"""Bits of ERROR that have a meaning here; 8 is a failure of the motor, 16 one of the hand's own communication."""
RELEASING, GRASPING, ARRIVED, PRESSED, CURRENT_STOP, STALL_STOP, FAULT_STOP, NEVER = 0, 1, 2, 3, 5, 6, 7, 255
"""Values of STATUS."""
_NEAR = 0.5


@dataclass
class Motor:
    """One of the six motors, from 0 (bent) to RANGE (stretched).

    Attributes:
        position: Where it is [counts].
        target: Where it goes [counts].
        speed: Speed as commanded, 0 to 1000.
        threshold: Force at which it stops closing [counts].
        met_at: Position at which the finger meets what is in the hand [counts]; None for nothing.
        jammed: Fault: it cannot move.
        says_arrived: Fault: it reports that it has arrived although it is jammed, as one hand did.
        temperature: Its temperature [deg C].
        error: Bits of ERROR.
        status: Value of STATUS.
    """

    position: float = RANGE
    target: float = RANGE
    speed: float = RANGE
    threshold: float = 500.0
    met_at: float | None = None
    jammed: bool = False
    says_arrived: bool = False
    temperature: float = 31.0
    error: int = 0
    status: int = NEVER
    _orders: deque[tuple[float, float]] = field(default_factory=deque)
    _forces: deque[tuple[float, float]] = field(default_factory=deque)
    _pushing: float = 0.0
    _stands: bool = True

    @property
    def force(self) -> float:
        """Force of the finger on what it holds [counts]."""
        return 0.0 if self.met_at is None else max(0.0, STIFFNESS * (self.met_at - self.position))

    @property
    def current(self) -> float:
        """Motor current [mA]: assumed; a standing motor needs none, its spindle locks itself."""
        return 20.0 if self._stands else 150.0 + 0.5 * self.force

    @property
    def told(self) -> tuple[float, float, float]:
        """Target, threshold and speed that it was given last."""
        return (self._orders[-1][1] if self._orders else self.target, self.threshold, self.speed)

    def go(self, target: float, now: float) -> None:
        """Take a target, which the motor heeds REACTION later.

        Args:
            target: Position to go to [counts].
            now: Time [s].
        """
        self._orders.append((now + REACTION, min(max(target, 0.0), RANGE)))

    def clear(self) -> None:
        """Clear the faults that can be cleared."""
        self.error &= OVERHEATED
        self._pushing = 0.0

    def advance(self, now: float, step: float) -> None:
        """Let time pass.

        Args:
            now: Time at the end of the step [s].
            step: Its length [s].
        """
        while self._orders and self._orders[0][0] <= now:
            _, self.target = self._orders.popleft()
            self._stands, self._pushing = False, 0.0
        self._heat()
        felt = 0.0
        while self._forces and self._forces[0][0] <= now - REACTION:
            _, felt = self._forces.popleft()
        if not self._stands:
            self._move(step, felt)
        self._forces.append((now, self.force))

    def _heat(self) -> None:
        if self.temperature >= HOT:
            self.error |= OVERHEATED
        elif self.temperature <= COOL:
            self.error &= ~OVERHEATED
        if self.error and not self._stands:
            self._stands = True
            self.status = {STALLED: STALL_STOP, OVER_CURRENT: CURRENT_STOP}.get(self.error, FAULT_STOP)

    def _move(self, step: float, felt: float) -> None:
        way = self.target - self.position
        if abs(way) < _NEAR or (self.jammed and self.says_arrived):
            self._stands, self.status = True, ARRIVED
        elif way < 0.0 and felt >= self.threshold:
            self._stands, self.status = True, PRESSED
        elif self.jammed:
            self._pushing += step
            if self._pushing >= STALL_TIME:
                self.error |= STALLED
                self._stands, self.status = True, STALL_STOP
        else:
            self.status = GRASPING if way < 0.0 else RELEASING
            most = FULL_SPEED * self.speed / RANGE * step
            self.position += min(max(way, -most), most)
