"""Of which devices and of what day a station's calibration is."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date

from toolee_robot.config.values import STRICT, NotNegative, Positive


@dataclass(frozen=True)
class CalibrationConfig:
    """Whose calibration the file holds: the camera's place holds for one robot, one camera, one day."""

    __pydantic_config__ = STRICT
    measured_on: str
    """Day of the calibration, as 2026-11-20."""
    robot_serial: str
    """Serial number of the robot that was calibrated; it must be the station's."""
    camera_serial: str
    """Serial number of the camera that was calibrated; it must be the station's."""
    residual: NotNegative
    """Root mean square of the board's points on poses held out from the fit [m]."""
    max_residual: Positive = 0.004
    """Largest residual that a job accepts [m]."""
    valid_days: Positive | None = 30.0
    """Days after which it must be repeated; null where nothing can have moved, as in the simulation."""

    def __post_init__(self) -> None:
        try:
            date.fromisoformat(self.measured_on)
        except ValueError as error:
            raise ValueError(f"measured_on {self.measured_on!r} is no date: write it as 2026-11-20") from error

    def problems(self, robot_serial: str, camera_serial: str, today: date) -> list[str]:
        """Why this calibration must not be used with these devices today, one sentence each; empty if it may."""
        found = []
        for what, mine, theirs in (
            ("robot", self.robot_serial, robot_serial),
            ("camera", self.camera_serial, camera_serial),
        ):
            if mine != theirs:
                found.append(f"it is of {what} {mine!r}, the station has {what} {theirs!r}: calibrate this one")
        age = (today - date.fromisoformat(self.measured_on)).days
        if age < 0:
            found.append(f"it was measured on {self.measured_on}, which is still to come: set the clock")
        elif self.valid_days is not None and age > self.valid_days:
            found.append(f"it is {age} days old, {self.valid_days:g} are allowed: calibrate again")
        if self.residual > self.max_residual:
            found.append(
                f"its residual is {self.residual * 1e3:.1f} mm, {self.max_residual * 1e3:.1f} are allowed: calibrate "
                "again with more and steeper poses"
            )
        return found


SIMULATED = "simulated"
"""The serial number of every simulated device."""
SIMULATED_CALIBRATION = CalibrationConfig("2026-01-01", SIMULATED, SIMULATED, 0.0, valid_days=None)
