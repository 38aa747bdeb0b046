"""`toolee arm freedrive`: a person moves the arm by hand and reads where it is."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.live import Live
from rich.text import Text

from toolee_robot.cli.arm.options import ArmOptions
from toolee_robot.cli.output import json_line
from toolee_robot.errors import UserError

PERIOD = 0.1
"""Time between two readings [s]."""


@dataclass(frozen=True, kw_only=True)
class Freedrive(ArmOptions):
    """Let a person move the arm by hand, and show the joints and the flange in both frames of the base.

    Example: toolee arm freedrive --robot-host 192.168.1.10 --config lab.yaml

    Any key ends it; the arm then holds its place. With a wrong payload the arm sinks or rises as soon as it is let go.
    """

    seconds: Annotated[float | None, tyro.conf.arg(metavar="S", help_behavior_hint="")] = None
    """End by itself after so long."""

    def run(self) -> int:
        if self.yes and self.seconds is None:
            raise UserError("--yes without --seconds: nobody would end it", code="user.option")
        console = Console(stderr=self.json, highlight=False)
        from toolee_robot.cli.arm.session import place_figures, place_text, session

        with session(self, console) as robot:
            robot.person.confirm("Freedrive: hold the arm, a wrong payload lets it sink or rise. Begin?")
            end = np.inf if self.seconds is None else time.monotonic() + self.seconds
            with robot.person.attending(), robot.arm.freedrive(), Live(console=console, auto_refresh=False) as live:
                while robot.person.hold_to_run_held() and time.monotonic() < end:
                    q = robot.arm.state().joints.q
                    joints = "  ".join(f"{value:8.4f}" for value in q)
                    place = place_text(robot.slow.robot.arm.fk(q))
                    live.update(Text(f"joints, rad {joints}\nflange {place}"), refresh=True)
                    time.sleep(PERIOD)
            q = robot.q
        console.print("\nThe arm holds its place.")
        if self.json:
            print(json_line({"q": q.tolist(), **place_figures(robot.slow.robot.arm.fk(q))}), flush=True)
        return 0
