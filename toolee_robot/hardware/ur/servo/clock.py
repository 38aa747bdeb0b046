"""Time for the servo loop: an absolute schedule on the station's clock, and what the system grants a real-time process.

A relative sleep drifts (125 Hz became 123.4 Hz in 5 s); deadlines that are all counted from one start do not. But the
controller counts its cycles by another crystal: 50 ppm apart, a fixed schedule would slip by one of the controller's
cycles every 40 to 160 s, and a command would be lost or come twice. So the schedule follows its packets, by
so little a cycle that their jitter does not matter.
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
"""[s] of the wall. Sleep until so long before a deadline, then watch the clock: the kernel wakes late, never early."""
AFTER_PACKET = 0.2
"""Of a period, from the controller's packet to a slot. The controller takes commands in when its cycle begins, sends
its packet some way into the cycle, and this process is late at times but never early: a command that is late by less
than half a cycle, which nobody counts, still comes in time."""
FOLLOW = 1e-4
"""Of a period, the most by which a slot moves against the one before in a motion: more than crystals differ."""
SEEK = 1e-2
"""Likewise at rest, where nothing depends on even slots: half a period is made up in 50 cycles. Packets come late
while a robot compiles the program that it has just been sent, and slots that begin by those are late ones."""
PRIORITY = 40
"""Of SCHED_FIFO: over everything ordinary, under the kernel's own interrupt threads (50)."""

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_PR_SET_TIMERSLACK = 29


class Schedule:
    """Slots at start + k * period [s] on `clock`."""

    def __init__(self, start: float, period: float, clock: HostClock) -> None:
        self._start, self._period, self._clock, self._slot = start, period, clock, 0

    @property
    def deadline(self) -> float:
        """Of the next slot [s]. Counted from the start: no rounding adds up."""
        return self._start + self._slot * self._period

    def resume(self) -> None:
        """Go on with the next slot to come; nothing was due in those that have passed."""
        self._slot += max(0, int((self._clock.now() - self.deadline) / self._period) + 1)

    def follow(self, arrived: float, by: float) -> None:
        """Move the slots by a part `by` of a period at most towards AFTER_PACKET after the time `arrived` [s] of a
        packet, of whichever cycle. Its phase alone counts: a packet that has overtaken its slot is a late one, not an
        early one of the next."""
        off = (arrived - self.deadline) / self._period + AFTER_PACKET
        self._start += self._period * min(max((off + 0.5) % 1.0 - 0.5, -by), by)

    def wait(self) -> tuple[float, int]:
        """Wait for the next slot. Returns how late it is [s] and how many slots were missed whole.

        A missed slot is skipped: commands sent in a burst would reach the robot in one of its cycles.
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
    """What the system granted. fifo: SCHED_FIFO. locked: the memory is never paged out. Without them the loop still
    keeps its schedule on an idle machine, and reports every slot that it misses."""

    fifo: bool
    locked: bool


def become_realtime() -> Realtime:
    """For this process and the threads that it starts from here on: no collector's pauses, and if permitted a
    real-time priority and memory that stays in place."""
    gc.collect()
    gc.freeze()
    gc.disable()
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)  # [ns]; the usual 50 us make every sleep late
    fifo = locked = False
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        fifo = True
    # With a limit in force, memory that is locked for the future makes a later allocation fail instead.
    with suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        locked = libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0
    return Realtime(fifo, locked)
