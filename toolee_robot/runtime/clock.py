"""Clocks of a station, and waiting for what can be read."""

from __future__ import annotations

import errno
import ipaddress
import os
import select
import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from toolee_robot.errors import UserError

MIN_REAL_TIME_FACTOR = 0.05
"""Smallest real-time factor: a cycle at 125 Hz then takes 160 ms of wall-clock time."""


@dataclass(frozen=True)
class HostClock:
    """A `hal.Clock` based on `time.monotonic()`; processes with the same real-time factor agree on the time.

    Attributes:
        real_time_factor: Rate of this clock relative to wall-clock time; 1 for every real robot.
    """

    real_time_factor: float = 1.0

    def now(self) -> float:
        """Return the present time [s]."""
        return time.monotonic() * self.real_time_factor

    def sleep(self, duration: float) -> None:
        """Wait for `duration` [s] of this clock."""
        if duration > 0:
            time.sleep(duration / self.real_time_factor)

    def to_wall_time(self, duration: float) -> float:
        """Convert a duration of this clock [s] to wall-clock time [s]."""
        return duration / self.real_time_factor


def check_real_time_factor(real_time_factor: float, host: str) -> None:
    """Check a real-time factor.

    Args:
        real_time_factor: The factor, MIN_REAL_TIME_FACTOR to 1.
        host: Address of the controller; only one on a loopback address may run slower than real time.

    Raises:
        UserError: The factor is out of range, or not 1 for a robot that may be real.
    """
    if not MIN_REAL_TIME_FACTOR <= real_time_factor <= 1.0:
        raise UserError(f"real-time factor {real_time_factor}: give {MIN_REAL_TIME_FACTOR} to 1, which is real time")
    if real_time_factor != 1.0 and not is_loopback(host):
        raise UserError(
            f"real-time factor {real_time_factor} for {host!r}: a real robot runs in real time. Only an emulated "
            "one on a loopback address (127.0.0.2, ...) may run slower"
        )


def is_loopback(host: str) -> bool:
    """Whether a host is an IPv4 loopback address; host names do not count, since they may resolve to anything."""
    try:
        return ipaddress.IPv4Address(host).is_loopback
    except ValueError:
        return False


SELECT_LIMIT = 1024
"""Descriptors from this number on `select.select` refuses: FD_SETSIZE, select(2)."""


def readable(descriptors: Sequence[int], timeout: float) -> list[int]:
    """Wait until something can be read; the end of a connection and an error count, too.

    Args:
        descriptors: What to wait for.
        timeout: Longest wait [s]; at most 0 for none. With a descriptor over SELECT_LIMIT it is rounded up to 1 ms.

    Returns:
        Those that are ready.

    Raises:
        OSError: One is closed.
        ValueError: One is negative, as that of a closed socket.
    """
    if max(descriptors, default=0) < SELECT_LIMIT:  # exact to microseconds, unlike poll
        return select.select(descriptors, [], [], max(timeout, 0.0))[0]
    poll = select.poll()
    for fd in descriptors:
        poll.register(fd, select.POLLIN)
    ready = poll.poll(ceil(1e3 * max(timeout, 0.0)))
    if any(events & select.POLLNVAL for _, events in ready):
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))
    return [fd for fd, _ in ready]
