"""`toolee arm`: its sub-commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from toolee_robot.cli.arm.freedrive import Freedrive
from toolee_robot.cli.arm.home import Home
from toolee_robot.cli.arm.lag import Lag
from toolee_robot.cli.arm.move import Move
from toolee_robot.cli.arm.touch import Touch
from toolee_robot.cli.arm.transfer import Transfer

_Action = (
    Annotated[Move, tyro.conf.subcommand("move")]
    | Annotated[Home, tyro.conf.subcommand("home")]
    | Annotated[Transfer, tyro.conf.subcommand("transfer")]
    | Annotated[Touch, tyro.conf.subcommand("touch")]
    | Annotated[Lag, tyro.conf.subcommand("lag")]
    | Annotated[Freedrive, tyro.conf.subcommand("freedrive")]
)


@dataclass(frozen=True)
class Arm:
    """Move a UR arm slowly, one confirmed motion at a time, under the supervisor: for its bring-up.

    Example: toolee arm move --robot-host 127.0.0.2 --joint 1 --by 0.05

    No joint turns faster than 0.1 rad/s, and hand and flange stay under supervisor.handover_speed.
    """

    action: Annotated[_Action, tyro.conf.arg(name="")]
    """What to do with the arm."""

    def run(self) -> int:
        return self.action.run()
