"""`toolee camera`: its sub-commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from toolee_robot.cli.camera.bench import BenchRegistration
from toolee_robot.cli.camera.check import CheckCamera
from toolee_robot.cli.camera.list_cameras import ListCameras
from toolee_robot.cli.camera.record import Record
from toolee_robot.cli.camera.show import Show

_Action = (
    Annotated[ListCameras, tyro.conf.subcommand("list")]
    | Annotated[Show, tyro.conf.subcommand("show")]
    | Annotated[Record, tyro.conf.subcommand("record")]
    | Annotated[CheckCamera, tyro.conf.subcommand("doctor")]
    | Annotated[BenchRegistration, tyro.conf.subcommand("bench")]
)


@dataclass(frozen=True)
class Camera:
    """Find, show, record and check an RGB-D camera.

    Example: toolee camera list
    """

    action: Annotated[_Action, tyro.conf.arg(name="")]
    """What to do with the camera."""

    def run(self) -> int:
        return self.action.run()
