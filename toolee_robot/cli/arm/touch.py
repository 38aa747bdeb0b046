"""`toolee arm touch`: a guarded approach."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro
from rich.console import Console

from toolee_robot.cli.arm.options import MotionOptions
from toolee_robot.cli.output import json_line
from toolee_robot.frames import Array

if TYPE_CHECKING:
    from toolee_robot.tasks.bring_up.caps import SlowStation
    from toolee_robot.tasks.bring_up.touch import Touch as Contact
    from toolee_robot.types import Trajectory


@dataclass(frozen=True, kw_only=True)
class Touch(MotionOptions):
    """Move straight on until the arm feels a force, tell where that was, and move back.

    Example: toolee arm touch --robot-host 192.168.1.10 --config lab.yaml --along 0 0 -0.1 --frame pendant_base

    Example: toolee arm touch --config lab.yaml --along 0 0 -0.03 --frame base_link --touches wood.yaml

    What is touched must be soft, such as a block of foam, and nothing of the station file: the hand may never touch
    that. A tip on the flange, of which the station file says nothing, may touch the wood, and --touches notes where for
    `toolee calibrate nail`. Any key stops the arm on its path, and so does Ctrl-C. Exit code 1: nothing was felt.
    """

    along: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")]
    """Longest way of the flange [m]."""
    frame: Literal["pendant_base", "base_link", "tool"]
    """Frame of --along: the pendant's Base, ROS's base_link (half a turn about z from it), or the flange's axes."""
    force: Annotated[float | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None
    """Force that ends the approach (default: strike.touch_force); a noisy force raises it by half at most."""
    speed: Annotated[float, tyro.conf.arg(metavar="M/S")] = 0.01
    """Speed of the approach; a noisy force lowers it."""
    touches: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """Add the joint positions of the contact to this list."""

    def run(self) -> int:
        console = Console(stderr=self.json, highlight=False)
        from toolee_robot.calibration.tip import add_touch, read_touches
        from toolee_robot.cli.arm.session import place_figures, place_text, session
        from toolee_robot.tasks.bring_up.touch import approach, measured_settings

        def noted(touch: Contact) -> None:
            """Before the way back: a stop on it does not cost the touch."""
            if self.touches is not None:
                count = add_touch(self.touches, touch.q)
                console.print(f"{self.touches} has {count} touch{'es' if count > 1 else ''}.", markup=False)

        if self.touches is not None and self.touches.exists():
            read_touches(self.touches)  # refuses what is no such list before anything moves
        with session(self, console) as robot:
            strike = robot.slow.config.strike
            force = strike.touch_force if self.force is None else self.force
            with console.status("measuring the force at rest"):
                settings = measured_settings(robot.arm, strike, force)
            speed = min(self.speed, settings.speed)
            plan = self.plan(robot.slow, robot.q, speed)
            slower = "" if speed == self.speed else " for the noise of the force"
            robot.show(f"touch: until {settings.force:.1f} N, at {1e3 * speed:.1f} mm/s{slower}, and back", plan)
            robot.person.confirm("Move?")
            with robot.person.attending():
                touch = approach(robot.arm, robot.slow, plan, settings, met=noted)
        if touch is None:
            console.print("[yellow]Nothing was felt on the whole way.[/yellow] The arm is back where it began.")
            figures: dict[str, object] = {"contact": False}
        else:
            where = place_text(touch.X_base_flange)
            console.print(
                f"Contact after {touch.travelled * 1e3:.1f} mm, {touch.force:.1f} N at rest. Flange: {where}",
                soft_wrap=True,
            )
            figures = {"contact": True, "travelled": touch.travelled, "force": touch.force}
            figures |= place_figures(touch.X_base_flange) | {"q": touch.q.tolist()}
        if self.json:
            print(json_line(figures), flush=True)
        return int(touch is None)

    def plan(self, slow: SlowStation, q: Array, speed: float | None = None) -> Trajectory:
        """Plan the approach.

        Args:
            slow: The station under its caps.
            q: Present joint positions, (6,) [rad].
            speed: Speed [m/s]; None for --speed.

        Returns:
            The trajectory, from rest to rest.

        Raises:
            TooleeError: The options are out of range, or the way is out of reach.
        """
        from toolee_robot.tasks.bring_up.jog import MotionFrame, plan_line

        return plan_line(slow, q, np.array(self.along), MotionFrame(self.frame), self.speed if speed is None else speed)
