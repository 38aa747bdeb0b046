"""The controller's ticks on an absolute schedule, and statistics of their timing."""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.runtime.clock import HostClock

CATCH_UP = 0.05  # [s] of delay that is caught up by back-to-back ticks; beyond it the schedule is shifted


@dataclass
class TickStatistics:
    """Statistics of the ticks.

    Attributes:
        ticks: Number of ticks.
        late: Ticks that began more than half a period late.
        slipped: Periods by which the schedule was shifted, because machine or physics were too slow.
        worst_late: Largest delay of a tick [s].
        busy: CPU time spent on all ticks [s].
    """

    ticks: int = 0
    late: int = 0
    slipped: int = 0
    worst_late: float = 0.0
    busy: float = 0.0


class Schedule:
    """The schedule of the ticks.

    After a late tick the next ones follow without a pause until the schedule is met again, so that the rate is kept on
    average. After a delay of more than CATCH_UP the schedule is shifted by whole periods instead: no tick is omitted,
    but the robot's time falls behind the clock.

    Args:
        period: Period of the ticks [s].
        clock: The robot's clock.

    Attributes:
        period: Period of the ticks [s].
        clock: The robot's clock.
        statistics: Statistics of the ticks.
    """

    def __init__(self, period: float, clock: HostClock) -> None:
        self.period, self.clock = period, clock
        self.statistics = TickStatistics()
        self._start, self._count = clock.now(), 0

    @property
    def due(self) -> float:
        """Time of the next tick [s]."""
        return self._start + self._count * self.period

    @property
    def overdue(self) -> bool:
        """Whether the next tick should have begun already."""
        return self.clock.now() > self.due

    def begin(self) -> float:
        """Begin the tick that is due; returns its scheduled time [s]."""
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
        """Restart the schedule with the first tick now."""
        self._start, self._count = self.clock.now(), 0

    def reset(self) -> None:
        """Reset the statistics."""
        self.statistics = TickStatistics()
