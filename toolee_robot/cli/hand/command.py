"""`toolee hand`: its sub-commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from toolee_robot.cli.hand.clear_faults import ClearFaults
from toolee_robot.cli.hand.close import Close
from toolee_robot.cli.hand.efforts import Efforts
from toolee_robot.cli.hand.open import Open
from toolee_robot.cli.hand.state import State

_Action = (
    Annotated[State, tyro.conf.subcommand("state")]
    | Annotated[Open, tyro.conf.subcommand("open")]
    | Annotated[Close, tyro.conf.subcommand("close")]
    | Annotated[ClearFaults, tyro.conf.subcommand("clear-faults")]
    | Annotated[Efforts, tyro.conf.subcommand("efforts")]
)


@dataclass(frozen=True)
class Hand:
    """Read, open or close the hand of a station file, or clear its faults, without a job.

    The arm is neither asked nor moved.

    Example: toolee hand state --station lab.yaml
    """

    action: Annotated[_Action, tyro.conf.arg(name="")]
    """What to do with the hand."""

    def run(self) -> int:
        return self.action.run()
