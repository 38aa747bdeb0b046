"""Forecast of the nail's protrusion between two measurements, and the decision when to measure it again.

A measurement takes longer than a strike. Wood resists a nail in proportion to the depth of its shank (friction; Forest
Products Laboratory, Wood Handbook, FPL-GTR-282, chapter 8), and every strike of a job brings about the same energy, so
that the square of the depth grows by the same amount with each: measured strikes tell the course of the others, the
better the deeper they have driven the nail. Each strike confirms it: the place of the contact tells where the head was.
"""

from __future__ import annotations

import math

import numpy as np

from toolee_robot.control.contact import ContactVerdict

FIRST, LONGEST = 2, 16
"""Number of strikes before the first measurement, unless one of them meets the nail elsewhere than expected: the deeper
they have driven it, the farther their measurement tells the course of the others; and largest number of successive
strikes without a measurement."""
ACCURACY, UNCERTAIN = 0.0007, 0.004
"""Accuracy of the depth between two measurements [m], and what the forecast may be off by for it [m]. A nail that was
driven by less than that accuracy is measured after every strike."""
LITTLE, AHEAD = 0.0025, 0.8
"""Depth that says little of the course [m], and what share of it the nail may be forecast to go before the next
measurement: one that is 1.2 mm short of it then puts the forecast off by less than 2 mm."""
MEASURED, FORECAST = 0.0005, 0.25
"""Standard deviation of a measured height [m], and of what strikes are forecast to drive, as a share of it."""
DISAGREEMENT, LATENESS = 0.003, 1.5
"""Deviation of a contact from the forecast above which the nail is measured [m], beyond the arm's travel in so many
control cycles: a force is felt up to a cycle late, and another one where it is noisy. In the mean of the last k
contacts the lateness counts by 1/sqrt(k): a bent nail shows in two or three contacts where one is too uncertain."""


class NailForecast:
    """The nail's protrusion as far as it is known.

    Args:
        length: Length of the nail [m].
        flush: Protrusion up to which a nail counts as flush [m].
        rate: Rate of the arm's readings [Hz].

    Attributes:
        height: Protrusion as forecast for now [m].
        unmeasured: Number of strikes since the last measurement.
        finished: Whether the nail was flush before the last strike, by forecast or measurement, and that strike met it
            where it should.
        surprise: What the last strike met otherwise than forecast, for a person; empty if nothing.
        below: How far below its forecast the nail's head was measured last [m]; 0 where nothing was forecast.
    """

    def __init__(self, length: float, flush: float, rate: float) -> None:
        self.height = 0.0
        self.unmeasured = 0
        self.finished = False
        self.surprise = ""
        self.below = 0.0
        self._length, self._flush, self._rate = length, flush, rate
        self._measured = 0.0
        self._first = 0.0  # height from which on strikes are counted [m]
        self._strikes = 0  # strikes between it and the last measurement
        self._growth: float | None = None  # of the squared depth in a strike [m^2]
        self._delays: list[float] = []
        self._offs: list[float] = []  # of the contacts since the last measurement, from the forecast [m]

    @property
    def unknown(self) -> int:
        """Number of strikes of which the height before the last one knew nothing."""
        return self.unmeasured if self._growth is None else 1

    @property
    def expected(self) -> float | None:
        """Mean progress of the strikes since the last measurement, if the head met no wood [m]; None if unknown."""
        if self._growth is None or not self.unmeasured:
            return None
        return (self._driven() - self._depth(self._measured)) / self.unmeasured

    @property
    def sigma(self) -> float:
        """Standard deviation of the height [m]: of a measurement, and of what was forecast since then."""
        if self.unmeasured and self._growth is None:
            return np.inf
        return float(np.hypot(MEASURED, FORECAST * (self._measured - self.height)))

    @property
    def left(self) -> float:
        """Number of strikes until the nail is flush, as far as is known; infinite if nothing is."""
        if not self._growth:
            return np.inf
        return max(float(self._depth(self._flush) ** 2 - self._depth(self.height) ** 2) / self._growth, 0.0)

    def measured(self, height: float, before: float | None = None) -> float:
        """Take over a measurement.

        Args:
            height: Measured protrusion [m].
            before: That of the measurement before, where this one tells more of it [m]; None for what it was.

        Returns:
            Mean progress of the strikes since the last measurement [m]; 0 if there were none.
        """
        progress = 0.0
        self.below = 0.0 if self._growth is None else self.height - height
        if before is not None:
            self._measured = before
        if self.unmeasured:
            progress = (self._measured - height) / self.unmeasured
            self._strikes += self.unmeasured
            growth = (self._depth(height) ** 2 - self._depth(self._first) ** 2) / self._strikes
            self._growth = max(growth, 0.0)
        else:  # a strike that was interrupted may have driven it
            self._first, self._strikes = height, 0
        if height > self._flush:
            self.finished = False
        self.height = self._measured = height
        self.unmeasured = 0
        self._offs.clear()
        return progress

    def struck(self, verdict: ContactVerdict, speed: float) -> bool:
        """Take over a strike that met the nail.

        Args:
            verdict: How it met the nail.
            speed: Speed of the face at the contact [m/s].

        Returns:
            Whether the nail must be measured before the next strike: it met the nail elsewhere than forecast, the nail
            was flush already by forecast, the forecast has become uncertain, or it was not measured for long; before
            the first measurement, whether there were enough strikes.
        """
        self.unmeasured += 1
        self.finished = self.height <= self._flush
        if self.unmeasured == 1:
            self._delays.append(verdict.before)  # the nail's height was known: this is the delay of the detection
        delay = float(np.mean(self._delays)) if self._delays else verdict.before
        self._offs.append(verdict.before - delay)
        off = self._disagreement(LATENESS * speed / self._rate)
        if self._growth is None:
            off = max(off, 0.0)  # nothing tells yet how far the strikes before have driven it
        self.surprise = ""
        if off:
            where = f"{abs(off) * 1e3:.0f} mm {'above' if off > 0 else 'below'}"
            self.surprise = f"the strike met the nail {where} its expected height: measuring it"
        if self._growth is None:
            return bool(self.surprise) or self.unmeasured >= FIRST
        self.height = max(self._length - self._driven(), 0.0)
        driven, ahead = self._first - self._measured, self._measured - self.height
        little = driven < ACCURACY or (driven < LITTLE and ahead > AHEAD * driven)
        uncertain = little or ahead * ACCURACY > UNCERTAIN * driven
        return bool(self.surprise) or self.finished or uncertain or self.unmeasured > LONGEST

    def unfelt(self, surprise: str) -> None:
        """Take over a strike whose contact was not felt where it should be; the nail must be measured.

        A light head's first push can stay under the threshold that a noisy force asks for; it is felt readings later.

        Args:
            surprise: What is odd about it.
        """
        self.unmeasured += 1
        self.finished = False
        self.surprise = surprise

    def _disagreement(self, lateness: float) -> float:
        """Mean deviation of the last contacts that is beyond what their lateness [m] explains [m]; 0 if none is."""
        counts = np.arange(1, len(self._offs) + 1)
        means = np.cumsum(self._offs[::-1]) / counts
        beyond = np.abs(means) > DISAGREEMENT + lateness / np.sqrt(counts)
        return float(means[np.argmax(beyond)]) if beyond.any() else 0.0

    def _driven(self) -> float:
        """Depth of the shank after the strikes since the last measurement, by forecast [m]."""
        assert self._growth is not None
        return float(np.sqrt(self._depth(self._measured) ** 2 + self.unmeasured * self._growth))

    def _depth(self, height: float) -> float:
        """Depth of the shank in the wood [m]."""
        return max(self._length - height, 0.0)


FEWEST, MOST = 2, 6
"""Number of strikes that tell that a nail stands still: of fast ones, and of those that drive it by so little that a
measurement hardly tells it."""
TELLS = 0.001
"""What strikes are expected to drive the nail together before a measurement tells that they did not [m]: 2.6 standard
deviations of the difference of two heights, which err by 0.27 mm each (`docs/results/job.md`)."""
SHARE = 0.5
"""Of the expected progress below which a nail that moves slowly is taken to stand still."""


class NailStall:
    """The strikes that seem not to have moved the nail.

    Near the end of its way a nail may move by less than `least` in every strike of a slow arm, and still goes in: so
    where little is expected, less is asked for, and more strikes have to tell.

    Args:
        least: Progress of a strike below which it has not moved the nail, unless less is expected [m].

    Attributes:
        strikes: Number of the latest strikes that together have not moved the nail.
        moved: What they have moved it by [m].
        suspected: Whether the last measurement makes one suspect that it stands still.
    """

    def __init__(self, least: float) -> None:
        self.strikes, self.moved = 0, 0.0
        self._least = self._usual = least
        self._needed = FEWEST
        self.suspected = False

    def __str__(self) -> str:
        return f"{self.strikes} strikes together moved the head by {max(self.moved, 0.0) * 1e3:.1f} mm"

    @property
    def over(self) -> bool:
        """Whether the nail stands still, as surely as its heights tell."""
        return self.strikes >= self._needed

    def measured(self, strikes: int, progress: float, expected: float | None) -> None:
        """Take over a measurement.

        Args:
            strikes: Number of strikes since the one before.
            progress: Their mean progress [m].
            expected: What was expected of it [m]; None if nothing was.
        """
        if not self.suspected and expected is not None:
            self._least = min(self._usual, SHARE * expected)
            self._needed = max(math.ceil(TELLS / max(expected, TELLS / MOST)), FEWEST)
        self.strikes, self.moved = self.strikes + strikes, self.moved + strikes * progress
        self.suspected = self.moved < self._least * self.strikes
        if not self.suspected:
            self.again()

    def again(self) -> None:
        """Count anew, with what was expected of the strikes so far: the tool was looked at."""
        self.strikes, self.moved = 0, 0.0
