"""Whether the hand has got its commands: rosbridge acknowledges none, the controllers' states show them."""

from __future__ import annotations

from collections import deque

import numpy as np

from toolee_robot.frames import Array

TOLERANCE = 0.02
"""Largest distance of a desired position from a commanded one that counts as the same [rad]."""
KEPT = 100
"""Commands that are kept."""


class Acknowledgement:
    """Follows the commands to the hand's controllers, and what these say that they want.

    Attributes:
        since: Time of the oldest command that no state has shown yet [s]; None if all were shown.
    """

    def __init__(self) -> None:
        self.since: float | None = None
        self._sent: deque[tuple[float, Array]] = deque(maxlen=KEPT)

    def sent(self, now: float, positions: Array) -> None:
        """Take a command.

        Args:
            now: Time at which it went out [s].
            positions: Positions of all joints, (n,) [rad].
        """
        self._sent.append((now, positions))
        if self.since is None:
            self.since = now

    def shown(self, stamp: float, desired: Array) -> None:
        """Take the state of the controllers.

        Args:
            stamp: Its time [s].
            desired: Where they want all joints to be, (n,) [rad].
        """
        if not self._sent:
            return
        found = [i for i, (_, at) in enumerate(self._sent) if np.abs(at - desired).max() <= TOLERANCE]
        if found:
            for _ in range(found[-1]):
                self._sent.popleft()
            self.since = self._sent[1][0] if len(self._sent) > 1 else None
        elif self.since is None and stamp > self._sent[-1][0]:  # somebody else has commanded it
            self.since = stamp
