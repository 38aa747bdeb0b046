"""From the touch pads' counts to newtons, relative to the pads at rest."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array

FINGERS, PADS = 5, 6
"""Fingers with pads (index, middle, ring, little, thumb), and pads of each."""
VOLTS = 3.3 / 4096.0
"""Volts of a count."""
PULL_DOWN, IN_SERIES = 33000.0, 10000.0
"""Resistances about a pad [Ohm]."""
NEWTON_OHM = 121591.0
"""Force by the pad's conductance [N Ohm]: the maker's placeholder, it has not calibrated the pads (ICD 3.4.6)."""


class Touch:
    """Forces of the fingers since the hand was asked first; pads at rest say something, each another number.

    A pad's rest is the least that it has said so far: one that was pressed from the beginning says too little until it
    was free once.
    """

    def __init__(self) -> None:
        self._rest: Array | None = None

    def newtons(self, counts: Array) -> Array:
        """Convert.

        Args:
            counts: What the pads say, (30,) [counts of 0 to 4095].

        Returns:
            Sum of the forces on each finger's pads, (5,) [N].
        """
        conductance = _conductance(counts)
        self._rest = conductance if self._rest is None else np.minimum(self._rest, conductance)
        force: Array = NEWTON_OHM * (conductance - self._rest)
        return force.reshape(FINGERS, PADS).sum(axis=1)


def _conductance(counts: Array) -> Array:
    """Of each pad [1/Ohm], 0 for one that is open or not there: R = 33000 / V + 10000 (ICD 3.4.6)."""
    volts = np.asarray(counts, float) * VOLTS
    return volts / (PULL_DOWN + IN_SERIES * volts)
