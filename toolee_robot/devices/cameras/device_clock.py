"""A device's clock on the station's clock, by the images that arrive with the least delay."""

from __future__ import annotations

MAX_DRIFT = 200e-6
"""Largest rate of drift between two clocks. Quartz oscillators are within 50 ppm of their frequency, so two of them
within 100."""


class DeviceClock:
    """Converts stamps of a device's clock to the station's clock.

    An image arrives at `device stamp + offset + delay`. The delay has a least value and is now and then longer, never
    shorter, so the smallest difference of arrival and stamp is the offset plus the least delay. The smallest one seen
    is let rise with MAX_DRIFT, the fastest that clocks drift apart: a minimum filter with a leak, after the clock
    filter of NTP (D. Mills, RFC 5905, section 10), which trusts the samples of the least delay.

    A converted stamp is thus late by the least delay, which no software can see from the stamps alone, and by at most
    MAX_DRIFT times twice the time since an image had it. A stream that becomes late stays seen as late: half a second
    of delay would be forgotten after 40 minutes.
    """

    def __init__(self) -> None:
        self._offset: float | None = None
        self._arrival = 0.0

    def surplus(self, stamp: float, arrival: float) -> float:
        """How much later an image arrives than those of the least delay.

        Args:
            stamp: The image's stamp on the device's clock [s].
            arrival: When it arrived, station's clock [s].

        Returns:
            The surplus [s]; negative where it comes earlier than the drift between the clocks permits, which none of a
            clock that runs evenly does once the least delay was seen.
        """
        if self._offset is None:
            return 0.0
        return arrival - stamp - self._leaked(arrival)

    def convert(self, stamp: float, arrival: float) -> float:
        """Convert a stamp, and learn from it.

        Args:
            stamp: The image's stamp on the device's clock [s].
            arrival: When it arrived, station's clock [s]; not before the last one's.

        Returns:
            The stamp on the station's clock [s]; never after the arrival.
        """
        seen = arrival - stamp
        self._offset = seen if self._offset is None else min(seen, self._leaked(arrival))
        self._arrival = arrival
        return stamp + self._offset

    def _leaked(self, arrival: float) -> float:
        assert self._offset is not None
        return self._offset + MAX_DRIFT * (arrival - self._arrival)
