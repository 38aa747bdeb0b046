"""`toolee arm move`: a jog of joints, or a straight motion of the flange."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro

from toolee_robot.cli.arm.options import MotionOptions, Vector
from toolee_robot.errors import UserError
from toolee_robot.frames import Array

if TYPE_CHECKING:
    from toolee_robot.tasks.bring_up.caps import SlowStation
    from toolee_robot.types import Trajectory


@dataclass(frozen=True, kw_only=True)
class Move(MotionOptions):
    """Move joints by a little, or the flange along a straight line, slowly, once a person has confirmed it.

    Example: toolee arm move --robot-host 192.168.1.10 --config lab.yaml --joint 3 --by 0.05

    Example: toolee arm move --robot-host 127.0.0.2 --along 0 0 0.05 --frame pendant_base

    The motion takes no way around anything: it is refused where something is in the way. Any key stops the arm on its
    path, and so does Ctrl-C.
    """

    joint: Annotated[int | None, tyro.conf.arg(metavar="1..6", help_behavior_hint="")] = None
    """Joint to turn: 1 base, 2 shoulder, 3 elbow, 4 to 6 wrists."""
    by: Annotated[float | None, tyro.conf.arg(metavar="RAD", help_behavior_hint="")] = None
    """By how much, with --joint."""
    to: Annotated[
        tuple[float, float, float, float, float, float] | None,
        tyro.conf.arg(metavar="RAD RAD RAD RAD RAD RAD", help_behavior_hint=""),
    ] = None
    """Joint positions to move to, base to wrist 3."""
    along: Vector = None
    """Way of the flange [m], with --frame."""
    frame: Annotated[
        Literal["pendant_base", "base_link", "tool"] | None,
        tyro.conf.arg(metavar="pendant_base|base_link|tool", help_behavior_hint=""),
    ] = None
    """Frame of --along: the pendant's Base, ROS's base_link (half a turn about z from it), or the flange's axes."""

    def run(self) -> int:
        jog = self.joint is not None and self.by is not None
        if (self.joint is None) != (self.by is None) or (self.along is None) != (self.frame is None):
            raise UserError("--joint goes with --by, and --along with --frame", code="user.option")
        if jog + (self.to is not None) + (self.along is not None) != 1:
            raise UserError("give one of --joint and --by, --to, or --along and --frame", code="user.option")
        from toolee_robot.cli.arm.session import run_motion

        return run_motion(self, "move", self.plan)

    def plan(self, slow: SlowStation, q: Array) -> Trajectory:
        """Plan the motion.

        Args:
            slow: The station under its caps.
            q: Present joint positions, (6,) [rad].

        Returns:
            The trajectory, from rest to rest.

        Raises:
            TooleeError: The options do not fit together, or no such motion exists.
        """
        from toolee_robot.tasks.bring_up.jog import MotionFrame, jog_joint, plan_joints, plan_line

        if self.along is not None and self.frame is not None:
            return plan_line(slow, q, np.array(self.along), MotionFrame(self.frame))
        if self.joint is not None and self.by is not None:
            return plan_joints(slow, q, jog_joint(q, self.joint, self.by))
        return plan_joints(slow, q, np.array(self.to))
