"""Log of a motion of the simulated arm."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.hal import MotionOutcome, MotionReport
from toolee_robot.types import JointState


class MotionLog:
    """What was sent and measured in a motion.

    Args:
        rate: Rate of the commands [Hz].

    Attributes:
        rate: Rate of the commands [Hz].
        stamps: Times of the rows [s].
        commanded: Commanded joint positions, (6,) [rad] each.
        measured: Measured joint positions, (6,) [rad] each.
        wrenches: Wrenches, (6,) [N, Nm] each.
        late: Number of late commands.
        late_in_a_row: Number of consecutive late commands up to the newest.
    """

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self.stamps: list[float] = []
        self.commanded: list[Array] = []
        self.measured: list[Array] = []
        self.wrenches: list[Array] = []
        self.late, self.late_in_a_row = 0, 0

    def add(self, stamp: float, commanded: Array, measured: Array, wrench: Array) -> None:
        """Append a row.

        Args:
            stamp: Time [s].
            commanded: Commanded joint positions, (6,) [rad].
            measured: Measured joint positions, (6,) [rad].
            wrench: Wrench, (6,) [N, Nm].
        """
        self.stamps.append(stamp)
        self.commanded.append(commanded.copy())
        self.measured.append(measured)
        self.wrenches.append(wrench)

    def count(self, late: bool) -> None:
        """Count a command, and whether it was sent late."""
        self.late += late
        self.late_in_a_row = self.late_in_a_row + 1 if late else 0

    def report(self, outcome: MotionOutcome, contact: JointState | None) -> MotionReport:
        """Build the motion's report.

        Args:
            outcome: How the motion ended.
            contact: Measured state at the contact, if there was one.

        Returns:
            The report.
        """
        stamps, commanded, measured, wrenches = map(
            np.array, (self.stamps, self.commanded, self.measured, self.wrenches)
        )
        return MotionReport(outcome, stamps, commanded, measured, wrenches, contact, self.late)
