"""The clock of a station with real drivers, and of every stamp in it: the host's, the same in all its processes.

Where the robot is a stand-in and its world is computed, the whole station may run slower than the wall's clock, so that
a busy machine keeps up with every cycle and no bound has to be wider than on a real robot.
"""

from __future__ import annotations

import ipaddress
import time
from dataclasses import dataclass

from toolee_robot.errors import UserError

MIN_REAL_TIME_FACTOR = 0.05
"""A cycle of 125 Hz takes 160 ms of the wall's clock at this real-time factor, and nothing else is gained."""


@dataclass(frozen=True)
class HostClock:
    """A `hal.Clock`: `time.monotonic()`, `real_time_factor` times as fast. Processes of one real-time factor agree on
    the time. 1 for every real robot."""

    real_time_factor: float = 1.0

    def now(self) -> float:
        return time.monotonic() * self.real_time_factor

    def sleep(self, duration: float) -> None:
        if duration > 0:
            time.sleep(duration / self.real_time_factor)

    def to_wall_time(self, duration: float) -> float:
        """[s] that `duration` [s] of this clock takes on the wall's."""
        return duration / self.real_time_factor


def check_real_time_factor(real_time_factor: float, host: str) -> None:
    """Raises UserError for a real-time factor that is not SLOWEST to 1, or not 1 for a robot that may be real."""
    if not MIN_REAL_TIME_FACTOR <= real_time_factor <= 1.0:
        raise UserError(f"real-time factor {real_time_factor}: give {MIN_REAL_TIME_FACTOR} to 1, which is real time")
    if real_time_factor != 1.0 and not is_loopback(host):
        raise UserError(
            f"real-time factor {real_time_factor} for {host!r}: a real robot runs in real time; only a stand-in on a "
            "loopback address "
            "(127.0.0.2, ...) may run slower"
        )


def is_loopback(host: str) -> bool:
    """Whether it is an IPv4 address of this machine alone. A name is none: it may lead anywhere."""
    try:
        return ipaddress.IPv4Address(host).is_loopback
    except ValueError:
        return False
