"""Timing of the servo loop: an absolute schedule on the station's clock, and real-time privileges of its process.

Deadlines are counted from one start, since relative sleeps accumulate drift. The controller's cycles are timed by
another crystal: at a difference of 50 ppm a fixed schedule would slip by one of the controller's cycles every 40 to
160 s, and a command would be lost or repeated. The schedule therefore tracks the arrival of the controller's packets,
with a correction per cycle so small that their jitter does not matter.
"""

from __future__ import annotations

import ctypes
import gc
import os
import resource
from contextlib import suppress
from dataclasses import dataclass

from toolee_robot.runtime.clock import HostClock

SPIN = 1e-4
"""[s] on the wall clock before a deadline, in which the loop spins on the clock: the kernel wakes late, never early."""
AFTER_PACKET = 0.2
"""Delay of a slot behind the controller's packet, as a fraction of the period. The controller reads commands at the
start of its cycle and sends its packet some way into it; with this delay a command that is late by less than half a
cycle, which does not count as an overrun, still arrives in time."""
FOLLOW = 1e-4
"""Largest correction of the schedule per cycle in a motion, as a fraction of the period: more than crystals differ."""
SEEK = 1e-2
"""The same at rest, where even slots do not matter: half a period is corrected in 50 cycles. Packets are delayed while
the robot compiles a program that it has just received, so a schedule that starts by them starts late."""
PRIORITY = 40
"""SCHED_FIFO priority: above all ordinary processes, below the kernel's interrupt threads (50)."""

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_PR_SET_TIMERSLACK = 29


class Schedule:
    """Command slots at start + k * period.

    Args:
        start: Time of the first slot [s].
        period: Time between two slots [s].
        clock: The clock of these times.
    """

    def __init__(self, start: float, period: float, clock: HostClock) -> None:
        self._start, self._period, self._clock, self._slot = start, period, clock, 0

    @property
    def deadline(self) -> float:
        """Time of the next slot [s]; counted from the start, so that rounding does not accumulate."""
        return self._start + self._slot * self._period

    def resume(self) -> None:
        """Continue with the next future slot; those that have passed do not count as missed."""
        self._slot += max(0, int((self._clock.now() - self.deadline) / self._period) + 1)

    def follow(self, arrived: float, by: float) -> None:
        """Shift the slots towards AFTER_PACKET periods after a packet's arrival; only the packet's phase counts.

        Args:
            arrived: Arrival of a packet, of any cycle [s].
            by: Largest shift, as a fraction of the period.
        """
        off = (arrived - self.deadline) / self._period + AFTER_PACKET
        self._start += self._period * min(max((off + 0.5) % 1.0 - 0.5, -by), by)

    def wait(self) -> tuple[float, int]:
        """Wait for the next slot. Missed slots are skipped: a burst of commands would reach the robot in one cycle.

        Returns:
            Delay behind the slot [s], and number of slots missed entirely.
        """
        deadline, clock = self.deadline, self._clock
        clock.sleep(deadline - clock.now() - SPIN * clock.real_time_factor)
        while (now := clock.now()) < deadline:
            pass
        missed = int((now - deadline) / self._period)
        self._slot += missed + 1
        return now - deadline - missed * self._period, missed


@dataclass(frozen=True)
class Realtime:
    """Real-time privileges that the operating system granted.

    Without them the loop still keeps its schedule on an idle machine, and reports every slot that it misses.

    Attributes:
        fifo: Whether the process runs under SCHED_FIFO.
        locked: Whether its memory is locked against paging.
    """

    fifo: bool
    locked: bool


def become_realtime() -> Realtime:
    """Make this process a real-time process as far as the operating system permits.

    Garbage collection is turned off; with the privileges, the process gets real-time priority, which threads started
    afterwards inherit, and its memory is locked.

    Returns:
        What was granted.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)  # [ns]; the default of 50 us delays every sleep
    fifo = locked = False
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        fifo = True
    # Under a limit, MCL_FUTURE would make later allocations fail, so the memory is locked only without one.
    with suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        locked = libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0
    return Realtime(fifo, locked)
