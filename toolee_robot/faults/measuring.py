"""A row of the matrix that is still to be measured, and how often it may be tried."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from toolee_robot.errors import TooleeError
from toolee_robot.faults.record import FaultRow, Phase
from toolee_robot.faults.rigs.driver_rig import MissedMomentError
from toolee_robot.runtime.latency_monitor import STALL_LIMIT, LatencyMonitor

ATTEMPTS = 3


@dataclass(frozen=True)
class Measurement:
    """number, fault, phase, on, expected: as in `FaultRow`. run: injects the fault and judges what comes of it."""

    number: int
    fault: str
    phase: Phase
    on: str
    expected: str
    run: Callable[[], FaultRow]

    def row(self, machine: LatencyMonitor) -> FaultRow:
        """Measured; and again, up to ATTEMPTS times in all, where it is not handled and the machine itself stalled
        meanwhile or the moment for the fault was missed. What could not be measured is not handled."""
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
