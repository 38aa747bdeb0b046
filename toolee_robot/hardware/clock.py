"""The clock of a station of real devices, and of every driver's stamps: the host's, the same in all its processes."""

from __future__ import annotations

import time


class MonotonicClock:
    """A `hal.Clock` on `time.monotonic()`."""

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, duration: float) -> None:
        if duration > 0:
            time.sleep(duration)
