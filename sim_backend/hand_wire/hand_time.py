"""The time in which an emulated hand's motors move."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class HandTime:
    """The host's time at some rate, held back behind a simulation that is slower.

    Args:
        pace: Rate relative to the host's.
    """

    def __init__(self, pace: float) -> None:
        self._pace, self._host = pace, time.monotonic()
        self._now = pace * self._host
        self._limit: Callable[[], float] | None = None
        self._lock = threading.Lock()

    def __call__(self) -> float:
        """The time [s]. It never goes back."""
        with self._lock:
            host = time.monotonic()
            now = self._now + self._pace * (host - self._host)
            if self._limit is not None:
                now = max(self._now, min(now, self._limit()))
            self._host, self._now = host, now
            return now

    @contextmanager
    def following(self, clock: Callable[[], float], ahead: float) -> Iterator[None]:
        """Keep it ahead of another clock by so much at most.

        Args:
            clock: Returns its time [s].
            ahead: By how much [s].

        Returns:
            The context in which it is so.
        """
        start = self() - clock()
        self._limit = lambda: clock() + start + ahead
        try:
            yield
        finally:
            self._limit = None
