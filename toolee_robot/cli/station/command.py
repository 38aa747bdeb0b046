"""`toolee station`: its sub-commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from toolee_robot.cli.station.check import Check
from toolee_robot.cli.station.new import New
from toolee_robot.cli.station.show import Show
from toolee_robot.cli.station.upgrade import Upgrade

_Action = (
    Annotated[New, tyro.conf.subcommand("new")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Show, tyro.conf.subcommand("show")]
    | Annotated[Upgrade, tyro.conf.subcommand("upgrade")]
)


@dataclass(frozen=True)
class Station:
    """Write, check, look at and upgrade the station file of a lab.

    Example: toolee station new lab.yaml
    """

    action: Annotated[_Action, tyro.conf.arg(name="")]
    """What to do with the file."""

    def run(self) -> int:
        return self.action.run()
