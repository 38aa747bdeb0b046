"""Contact detection by force: the mean of a window, absolute or as a rise above the readings just before it.

In a fast motion the absolute force says little: an estimate from joint currents contains what the controller's model
misses of friction and inertia, and any sensor's offset drifts with the pose. Both change slowly. A contact is a step.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard


class ContactForce:
    """Detects a contact in the readings of one motion; a reading costs the same however long the windows are.

    Args:
        guard: What counts as a contact.
        period: Time between two readings [s].
    """

    def __init__(self, guard: ContactGuard, period: float) -> None:
        self._force = guard.force
        self._window = max(round(guard.averaging_window / period), 1)
        self._baseline = max(round(guard.baseline / period), 1) if guard.baseline > 0.0 else 0
        self._readings: deque[Array] = deque()
        self._newest, self._older = np.zeros(3), np.zeros(3)  # sums over window and baseline

    def add(self, force: Array) -> bool:
        """Add a reading.

        Args:
            force: Force at the flange, (3,) [N].

        Returns:
            Whether the newest readings are a contact.
        """
        readings, longest = self._readings, self._window + self._baseline
        readings.append(force)
        self._newest += force
        if len(readings) > self._window:
            self._newest -= readings[-self._window - 1]
            self._older += readings[-self._window - 1]
        if len(readings) > longest:
            self._older -= readings.popleft()
        if len(readings) < longest:
            return False
        step = self._newest / self._window
        if self._baseline:
            step -= self._older / self._baseline
        return float(step @ step) > self._force**2
