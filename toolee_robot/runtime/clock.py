"""The clock of a station with real drivers, and of every stamp in it: the host's, the same in all its processes.

Where the robot is a stand-in and its world is computed, the whole station may run slower than the wall's clock, so that
a busy machine keeps up with every cycle and no bound has to be wider than on a real robot.
"""

from __future__ import annotations

import ipaddress
import time
from dataclasses import dataclass

from toolee_robot.errors import UserError

SLOWEST = 0.05
"""A cycle of 125 Hz takes 160 ms of the wall's clock at this pace, and nothing else is gained."""


@dataclass(frozen=True)
class HostClock:
    """A `hal.Clock`: `time.monotonic()`, `pace` times as fast. Processes of one pace agree on the time. 1 for every
    real robot."""

    pace: float = 1.0

    def now(self) -> float:
        return time.monotonic() * self.pace

    def sleep(self, duration: float) -> None:
        if duration > 0:
            time.sleep(duration / self.pace)

    def wall(self, duration: float) -> float:
        """[s] that `duration` [s] of this clock takes on the wall's."""
        return duration / self.pace


def check_pace(pace: float, host: str) -> None:
    """Raises UserError for a pace that is not SLOWEST to 1, or not 1 for a robot that may be real."""
    if not SLOWEST <= pace <= 1.0:
        raise UserError(f"pace {pace}: give {SLOWEST} to 1, which is real time")
    if pace != 1.0 and not is_loopback(host):
        raise UserError(
            f"pace {pace} for {host!r}: a real robot runs in real time; only a stand-in on a loopback address "
            "(127.0.0.2, ...) may run slower"
        )


def is_loopback(host: str) -> bool:
    """Whether it is an IPv4 address of this machine alone. A name is none: it may lead anywhere."""
    try:
        return ipaddress.IPv4Address(host).is_loopback
    except ValueError:
        return False
