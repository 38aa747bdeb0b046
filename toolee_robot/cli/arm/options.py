"""Options that the `toolee arm` commands share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from toolee_robot.cli.options import Flag
from toolee_robot.errors import UserError
from toolee_robot.runtime.clock import is_loopback
from toolee_robot.station import StationConfig, load_lab_station, load_station

Vector = Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z", help_behavior_hint="")]
"""Three numbers, or none."""


@dataclass(frozen=True, kw_only=True)
class ArmOptions:
    """Where the robot is, and what station it belongs to."""

    robot_host: Annotated[
        str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: arm.host of the station file)")
    ] = None
    """Address of the UR controller: a robot's, or the loopback address of `toolee ur-controller`."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """The station file, whose limits hold; a stand-in may do without."""
    yes: Flag = False
    """Ask nobody and mind no key: for scripts, with a stand-in on a loopback address only."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def load(self) -> tuple[StationConfig, str]:
        """Load the station.

        Returns:
            The station, and the address of its controller.

        Raises:
            UserError: No address is known; or a robot without a station file, or one that nobody attends.
            ConfigError: The file is invalid, or a robot's leaves out what must be measured.
        """
        station = StationConfig() if self.config is None else load_station(self.config)
        host = self.robot_host or station.arm.host
        if host is None:
            raise UserError(
                "no robot: give --config with a station file that names arm.host, or --robot-host",
                code="user.no_robot_host",
            )
        if is_loopback(host):
            return station, host
        if self.yes:
            raise UserError(
                f"--yes for {host}, which may be a robot: a person confirms each of its motions",
                code="user.unattended_robot",
            )
        if self.config is None:
            raise UserError(
                f"--robot-host {host} without --config: a robot moves in its own station only", code="user.no_station"
            )
        return load_lab_station(self.config), host


@dataclass(frozen=True, kw_only=True)
class MotionOptions(ArmOptions):
    """How fast a motion may be."""

    max_speed: Annotated[float, tyro.conf.arg(metavar="RAD/S")] = 0.1
    """Cap of every joint's speed; a higher one is for later, and the station file's limits hold all the same."""
    max_acceleration: Annotated[float, tyro.conf.arg(metavar="RAD/S2")] = 1.0
    """Cap of every joint's acceleration, likewise."""
