"""Measurement of a row of the matrix, with repetitions after stalls of the machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from toolee_robot.errors import TooleeError
from toolee_robot.faults.record import FaultRow, Phase
from toolee_robot.faults.rigs.driver_rig import MissedMomentError
from toolee_robot.runtime.latency_monitor import STALL_LIMIT, LatencyMonitor

ATTEMPTS = 3
"""Largest number of measurements of a row."""


@dataclass(frozen=True)
class Measurement:
    """A row that is to be measured.

    Attributes:
        number: See `FaultRow`.
        fault: See `FaultRow`.
        phase: See `FaultRow`.
        on: See `FaultRow`.
        expected: See `FaultRow`.
        run: Injects the fault and judges the reaction.
    """

    number: int
    fault: str
    phase: Phase
    on: str
    expected: str
    run: Callable[[], FaultRow]

    def row(self, machine: LatencyMonitor) -> FaultRow:
        """Measure the row, and repeat it where it is not handled and the machine stalled or the moment was missed.

        A row that cannot be measured counts as not handled.

        Args:
            machine: Running monitor of the machine's stalls.
        """
        again = 0
        while True:
            machine.begin()
            try:
                row, missed = self.run(), False
            except TooleeError as error:
                row, missed = self._failed(error), isinstance(error, MissedMomentError)
            excused = missed or machine.longest > STALL_LIMIT
            if row.handled or not excused or again == ATTEMPTS - 1:
                return replace(row, again=again)
            again += 1

    def _failed(self, error: TooleeError) -> FaultRow:
        why = f"{type(error).__name__}: {error}"
        return FaultRow(self.number, self.fault, self.phase, self.on, self.expected, "not measured", False, False, why)
