"""Where the motors are told to be from one command to the next: ramps, and the way back that frees a finger."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array

BACK, BACK_TIME = 1.0, 0.06
"""Way and time for which a finger that has collided is told to open before it can close further [deg], [s]."""


class Setpoints:
    """Setpoints of the m motors, which move towards targets at speeds of their own.

    The hand has no speeds: it goes to a position as fast as it can. A slow finger is one whose setpoint moves slowly.

    Args:
        closures: Where the motors are, (m,) [deg].
        lead: Largest way by which a setpoint is ahead of a motor [deg].
    """

    def __init__(self, closures: Array, lead: float) -> None:
        self._lead = lead
        self._setpoint, self._target = closures.copy(), closures.copy()
        self._speed = np.zeros(len(closures))
        self._back_until = np.full(len(closures), -np.inf)
        self._back_to = np.zeros(len(closures))
        self._stamp: float | None = None

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Whether each motor is told to move, (m,)."""
        return np.asarray(np.abs(self._setpoint - self._target) > 1e-9)

    @property
    def at(self) -> Array:
        """Where the motors are told to be, (m,) [deg]."""
        return self._setpoint

    @property
    def way(self) -> Array:
        """Way to each motor's target, positive closing, (m,) [deg]."""
        return self._target - self._setpoint

    def go(self, motors: list[int], targets: Array, speed: Array | float) -> None:
        """Send motors to targets.

        Args:
            motors: The motors.
            targets: Closures of all, (m,) [deg].
            speed: Their speed, or that of each [deg/s].
        """
        self._target[motors], self._speed[motors] = targets[motors], speed

    def slow(self, motors: NDArray[np.bool_], speed: Array | float) -> None:
        """Let motors that are on their way go on at a speed.

        Args:
            motors: Which of them, (m,).
            speed: Their speed, or that of each, (m,) [deg/s].
        """
        self._speed = np.where(motors, np.minimum(self._speed, speed), self._speed)

    def hold(self, motors: NDArray[np.bool_], at: Array) -> None:
        """Keep motors at places.

        Args:
            motors: Which of them, (m,).
            at: The places, (m,) [deg].
        """
        self._setpoint[motors] = self._target[motors] = at[motors]

    def free(self, motors: list[int], closures: Array, towards: float) -> None:
        """Tell fingers to go the other way for a moment: after a collision they may then go on.

        Args:
            motors: The fingers.
            closures: Where all motors are, (m,) [deg].
            towards: 1 for fingers that shall close further, -1 for those that shall open.
        """
        now = self._stamp or 0.0
        self._back_until[motors] = now + BACK_TIME
        self._back_to[motors] = closures[motors] - towards * BACK
        self._setpoint[motors] = closures[motors]

    def advance(self, now: float, closures: Array) -> tuple[float, ...]:
        """Move the setpoints.

        Args:
            now: Time [s].
            closures: Where the motors are, (m,) [deg].

        Returns:
            What to command [deg].
        """
        step = 0.0 if self._stamp is None else min(max(now - self._stamp, 0.0), 0.1)
        self._stamp = now
        back = now < self._back_until
        way = np.clip(self._target - self._setpoint, -self._speed * step, self._speed * step)
        moved = np.clip(self._setpoint + way, closures - self._lead, closures + self._lead)
        self._setpoint = np.where(self.moving & ~back, moved, self._setpoint)
        command = np.where(back, self._back_to, self._setpoint)
        return tuple(float(angle) for angle in command)
