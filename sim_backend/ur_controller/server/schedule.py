"""The controller's clock: ticks on an absolute schedule, and what is known about how well it was kept."""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.runtime.clock import HostClock

CATCH_UP = 0.05  # [s] of being late that is caught up by ticks back to back; beyond it the schedule moves


@dataclass
class TickStatistics:
    """ticks: done. late: begun later than half a period after their time. slipped: periods by which the schedule had
    to be moved, because the machine or the physics was too slow for the real-time factor. worst_late [s]. busy [s]: of
    the processor, spent on all ticks."""

    ticks: int = 0
    late: int = 0
    slipped: int = 0
    worst_late: float = 0.0
    busy: float = 0.0


class Schedule:
    """When the next tick is due. Times are of `clock` [s].

    A late tick is followed by the next ones without a pause until the schedule is met again, so that the rate is kept
    on average; after more than CATCH_UP the schedule moves by whole periods instead, which is counted: robot time
    then runs behind the clock, and no tick is left out.
    """

    def __init__(self, period: float, clock: HostClock) -> None:
        self.period, self.clock = period, clock
        self.statistics = TickStatistics()
        self._start, self._count = clock.now(), 0

    @property
    def due(self) -> float:
        """Time of the next tick."""
        return self._start + self._count * self.period

    @property
    def overdue(self) -> bool:
        """Whether the next tick should have begun already."""
        return self.clock.now() > self.due

    def begin(self) -> float:
        """The tick that is due begins; returns its time on the schedule."""
        due, statistics = self.due, self.statistics
        late = self.clock.now() - due
        if late > CATCH_UP:
            periods = int(late / self.period)
            statistics.slipped += periods
            self._start += periods * self.period
        statistics.late += late > 0.5 * self.period
        statistics.worst_late = max(statistics.worst_late, late)
        statistics.ticks += 1
        self._count += 1
        return due

    def restart(self) -> None:
        """The first tick is due now."""
        self._start, self._count = self.clock.now(), 0

    def reset(self) -> None:
        """Forget the statistics."""
        self.statistics = TickStatistics()
