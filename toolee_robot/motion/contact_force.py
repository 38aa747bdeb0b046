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
    """Detects a contact in the readings of one motion.

    Args:
        guard: What counts as a contact.
        period: Time between two readings [s].
    """

    def __init__(self, guard: ContactGuard, period: float) -> None:
        self._force = guard.force
        self._window = max(round(guard.averaging_window / period), 1)
        self._baseline = max(round(guard.baseline / period), 1) if guard.baseline > 0.0 else 0
        self._readings: deque[Array] = deque(maxlen=self._window + self._baseline)

    def add(self, force: Array) -> bool:
        """Add a reading.

        Args:
            force: Force at the flange, (3,) [N].

        Returns:
            Whether the newest readings are a contact.
        """
        self._readings.append(force)
        if len(self._readings) < self._window + self._baseline:
            return False
        return bool(np.linalg.norm(step(np.array(self._readings), self._baseline)) > self._force)


def step(readings: Array, baseline: int) -> Array:
    """Rise of the force within a series of readings.

    Args:
        readings: Readings, (N, 3) [N].
        baseline: Number of readings, from the first on, to compare with; 0 for the absolute force.

    Returns:
        Mean of the readings after the baseline, less the baseline's mean, (3,) [N].
    """
    mean: Array = np.mean(readings[baseline:], axis=0)
    return mean - np.mean(readings[:baseline], axis=0) if baseline else mean
