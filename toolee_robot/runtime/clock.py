"""The clock of a station with real drivers: the host's monotonic clock, shared by all processes.

With a controller stand-in and a simulated world the station may run slower than real time, so that a busy machine keeps
up with every cycle and no bound has to be wider than on a real robot.
"""

from __future__ import annotations

import ipaddress
import time
from dataclasses import dataclass

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
        raise UserError(
            f"real-time factor {real_time_factor}: give {MIN_REAL_TIME_FACTOR} to 1, which is real time",
            code="user.real_time_factor",
        )
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
