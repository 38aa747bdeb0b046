"""`toolee arm home` and `toolee arm transfer`: to a place of the station, around what is in the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from toolee_robot.cli.arm.options import MotionOptions
from toolee_robot.frames import Array

if TYPE_CHECKING:
    from toolee_robot.tasks.bring_up.caps import SlowStation
    from toolee_robot.types import Trajectory


@dataclass(frozen=True, kw_only=True)
class Transfer(MotionOptions):
    """Move to a place of the station on a way that is checked for collisions, once a person has confirmed it.

    Example: toolee arm transfer --robot-host 192.168.1.10 --config lab.yaml --to handover

    The hand is open and empty. Any key stops the arm on its path, and so does Ctrl-C.
    """

    to: Literal["home", "handover", "view", "nail"]
    """handover: where a tool is handed over; view: where the camera would look at a tool; nail: where a strike would
    begin, over the nail; home: scene.home."""
    view: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """Which view, with --to view."""

    def run(self) -> int:
        from toolee_robot.cli.arm.session import run_motion

        return run_motion(self, f"to {self.to}", self.plan)

    def plan(self, slow: SlowStation, q: Array) -> Trajectory:
        """Plan the motion.

        Args:
            slow: The station under its caps.
            q: Present joint positions, (6,) [rad].

        Returns:
            The trajectory, from rest to rest.

        Raises:
            TooleeError: The place is out of reach, or no way there is clear.
        """
        from toolee_robot.tasks.bring_up.places import Place, plan_to_place

        return plan_to_place(slow, q, Place(self.to), self.view)
