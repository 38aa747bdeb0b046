"""Forecast of the nail's protrusion between two measurements, and the decision when to measure it again.

A measurement takes longer than a strike. Between two of them the nail's height follows from the progress of the last
measured strikes, and each strike confirms it: the place of the contact tells where the head was.
"""

from __future__ import annotations

import numpy as np

from toolee_robot.control.contact import ContactVerdict

LONGEST = 4
"""Largest number of successive strikes without a measurement."""
DECAY = 0.9
"""Progress of a strike relative to the one before: the deeper a nail, the more wood holds it."""
DISAGREEMENT, LATENESS = 0.003, 1.5
"""Deviation of a contact from the forecast above which the nail is measured [m], beyond the arm's travel in so many
control cycles: a force is felt up to a cycle late, and another one where it is noisy."""


class NailForecast:
    """The nail's protrusion as far as it is known.

    Args:
        flush: Protrusion from which on every strike is followed by a measurement [m].
        rate: Rate of the arm's readings [Hz].

    Attributes:
        height: Protrusion as forecast for now [m].
        unmeasured: Number of strikes since the last measurement.
        surprise: What the last strike met otherwise than forecast, for a person; empty if nothing.
    """

    def __init__(self, flush: float, rate: float) -> None:
        self.height = 0.0
        self.unmeasured = 0
        self.surprise = ""
        self._flush, self._rate = flush, rate
        self._measured = 0.0
        self._progress: float | None = None
        self._delays: list[float] = []

    def measured(self, height: float) -> float:
        """Take over a measurement.

        Args:
            height: Measured protrusion [m].

        Returns:
            Mean progress of the strikes since the last measurement [m]; 0 if there were none.
        """
        progress = 0.0
        if self.unmeasured:
            progress = (self._measured - height) / self.unmeasured
            # The mean is that of the strike in the middle; the forecast begins with the last one.
            self._progress = max(progress, 0.0) * DECAY ** (0.5 * (self.unmeasured - 1))
        self.height = self._measured = height
        self.unmeasured = 0
        return progress

    def struck(self, verdict: ContactVerdict, speed: float) -> bool:
        """Take over a strike that met the nail.

        Args:
            verdict: How it met the nail.
            speed: Speed of the face at the contact [m/s].

        Returns:
            Whether the nail must be measured before the next strike.
        """
        self.unmeasured += 1
        if self.unmeasured == 1:
            self._delays.append(verdict.before)  # the nail's height was known: this is the delay of the detection
        off = verdict.before - float(np.mean(self._delays))
        self.surprise = ""
        if abs(off) > LATENESS * speed / self._rate + DISAGREEMENT:
            where = f"{abs(off) * 1e3:.0f} mm {'above' if off > 0 else 'below'}"
            self.surprise = f"the strike met the nail {where} where it was expected: measuring it"
        if self._progress is None:
            return True
        steps = [self._progress * DECAY ** (k + 1) for k in range(self.unmeasured + 1)]
        self.height = self._measured - sum(steps[:-1])
        return bool(self.surprise) or self.unmeasured > LONGEST or self._measured - sum(steps) <= self._flush
