"""The record of a camera calibration, and its validity."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from typing import Annotated

from toolee_robot.station.values import STRICT
from toolee_robot.types.units import Metres, Unit

SIMULATED = "simulated"
"""Serial number of every simulated device, and of the robot of a rehearsed calibration: no real one has it, so that no
job on a robot takes what was rehearsed for its own."""


@dataclass(frozen=True)
class CalibrationConfig:
    """The hand-eye calibration that determined `StationConfig.camera`.

    It holds for one robot, one camera and a limited time. A station file names the `record` that `toolee calibrate
    camera` wrote, which gives date, serial numbers and residual; of a calibration by another program it gives these
    four itself.
    """

    __pydantic_config__ = STRICT
    measured_on: str
    """Date of the calibration, ISO 8601 (2026-11-20)."""
    robot_serial: str
    """Serial number of the calibrated robot; must be that of the station's robot."""
    camera_serial: str
    """Serial number of the calibrated camera; must be that of the station's camera."""
    residual: Annotated[float, Metres(0.0, 0.1)]
    """Root mean square error of the calibration board's points on held-out poses, across the line of sight."""
    max_residual: Annotated[float, Metres(0.0001, 0.02)] = 0.004
    """Largest residual with which the calibration may be used."""
    valid_days: Annotated[float, Unit("days", 0.1, 3650.0)] | None = 30.0
    """Days after which the calibration must be repeated; None if nothing can have moved, as in the simulation."""
    record: str | None = None
    """The calibration's record, a file; its place is relative to the station file's."""

    def __post_init__(self) -> None:
        try:
            date.fromisoformat(self.measured_on)
        except ValueError as error:
            raise ValueError(f"measured_on {self.measured_on!r} is no date: write it as 2026-11-20") from error

    def problems(self, robot_serial: str, camera_serial: str, today: date) -> list[str]:
        """Check whether this calibration may be used.

        Args:
            robot_serial: Serial number that the station's robot reports.
            camera_serial: Serial number that the station's camera reports.
            today: The present date.

        Returns:
            One sentence per reason against its use; empty if it may be used.
        """
        found = []
        for what, mine, theirs in (
            ("robot", self.robot_serial, robot_serial),
            ("camera", self.camera_serial, camera_serial),
        ):
            if mine != theirs:
                of = "it was simulated or rehearsed" if mine == SIMULATED else f"it is of {what} {mine!r}"
                found.append(f"{of}, the station has {what} {theirs!r}: calibrate this one")
        age = (today - date.fromisoformat(self.measured_on)).days
        if age < -1:  # dates have no zone: elsewhere it may be a day later
            found.append(f"it was measured on {self.measured_on}, which is still to come: set the clock")
        elif self.valid_days is not None and age > self.valid_days:
            found.append(f"it is {age} days old, {self.valid_days:g} are allowed: calibrate again")
        if self.residual > self.max_residual:
            found.append(
                f"its residual is {self.residual * 1e3:.1f} mm, {self.max_residual * 1e3:.1f} are allowed: calibrate "
                "again with more and steeper poses"
            )
        return found


SIMULATED_CALIBRATION = CalibrationConfig("2026-01-01", SIMULATED, SIMULATED, 0.0, valid_days=None)
"""Calibration of the simulated station: exact, and valid without a time limit."""
