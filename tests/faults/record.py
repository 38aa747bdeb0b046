"""One row of the fault matrix: the fault, its time and the reaction; and its measurement, again after stalls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

from tests.stalls import STALL_LIMIT
from toolee_robot.errors import DeviceError, TooleeError
from toolee_robot.runtime.latency_monitor import LatencyMonitor

ATTEMPTS = 3
"""Largest number of measurements of a row."""


class MissedMomentError(DeviceError):
    """The fault was injected before or after the swing, or the arm did not get to its start."""


class Phase(StrEnum):
    """When the fault is injected."""

    START = "at the start"
    REST = "at rest"
    SWING = "in mid-swing"
    SLOW = "in a slow motion"


@dataclass(frozen=True)
class FaultRow:
    """Result of one fault; times and distances are None where nothing moved or nothing is timed."""

    number: int
    fault: str
    phase: Phase
    on: str
    expected: str
    got: str
    latched: bool
    handled: bool
    why: str = ""
    reaction: float | None = None
    standstill: float | None = None
    allowed: float | None = None
    speed: float | None = None
    off_path: float | None = None
    again: int = 0


@dataclass(frozen=True)
class Measurement:
    """A row that is to be measured: the first fields of a `FaultRow`, and what injects the fault and judges it."""

    number: int
    fault: str
    phase: Phase
    on: str
    expected: str
    run: Callable[[], FaultRow]

    def row(self, machine: LatencyMonitor) -> FaultRow:
        """Measure the row; again where it is not handled, and the machine stalled or the moment was missed."""
        again = 0
        while True:
            machine.begin()
            try:
                row, missed = self.run(), False
            except TooleeError as error:
                row, missed = self._failed(f"{type(error).__name__}: {error}"), isinstance(error, MissedMomentError)
            excused = missed or machine.longest > STALL_LIMIT
            if row.handled or not excused or again == ATTEMPTS - 1:
                return replace(row, again=again)
            again += 1

    def _failed(self, why: str) -> FaultRow:
        return FaultRow(self.number, self.fault, self.phase, self.on, self.expected, "not measured", False, False, why)
