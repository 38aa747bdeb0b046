"""`toolee calibrate`: its sub-commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from toolee_robot.cli.calibrate.board import PrintBoard
from toolee_robot.cli.calibrate.camera import Camera
from toolee_robot.cli.calibrate.check import Check
from toolee_robot.cli.calibrate.intrinsics import Intrinsics
from toolee_robot.cli.calibrate.mount import Mount
from toolee_robot.cli.calibrate.nail import Nail

_Action = (
    Annotated[PrintBoard, tyro.conf.subcommand("board")]
    | Annotated[Camera, tyro.conf.subcommand("camera")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Intrinsics, tyro.conf.subcommand("intrinsics")]
    | Annotated[Mount, tyro.conf.subcommand("mount")]
    | Annotated[Nail, tyro.conf.subcommand("nail")]
)


@dataclass(frozen=True)
class Calibrate:
    """Calibrate a station: where the camera stands, and where tip and nail are, seen from the robot.

    Example: toolee calibrate board --sheet a3 --out board.pdf

    Example: toolee calibrate camera
    """

    action: Annotated[_Action, tyro.conf.arg(name="")]
    """What to do."""

    def run(self) -> int:
        return self.action.run()
