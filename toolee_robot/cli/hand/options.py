"""Options that the `toolee hand` commands share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from toolee_robot.cli.options import Flag
from toolee_robot.errors import UserError

if TYPE_CHECKING:
    from toolee_robot.station import HandConfig


@dataclass(frozen=True, kw_only=True)
class HandOptions:
    """Which hand."""

    station: Annotated[Path, tyro.conf.arg(metavar="YAML")]
    """The station file, whose hand is meant; of the rest nothing is needed."""
    port: Annotated[str | None, tyro.conf.arg(metavar="PORT", help_behavior_hint="(default: hand.port)")] = None
    """Where the hand is instead, such as the port that `toolee hand-emulator` prints."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def hand(self) -> HandConfig:
        """Read what the station file says of the hand.

        Returns:
            It, at the port that is meant.

        Raises:
            UserError: It is a tool mount (`user.no_fingers`).
            ConfigError: The file cannot be read, or is invalid.
        """
        from toolee_robot.robots import MOUNT
        from toolee_robot.station import load_station

        hand = load_station(self.station).hand
        if hand.model == MOUNT:
            raise UserError(
                f"the hand of {self.station} is a tool mount, which has neither motors nor sensors: fix a tool in it, "
                "and take it out, by hand",
                code="user.no_fingers",
            )
        return hand if self.port is None else replace(hand, port=self.port)


@dataclass(frozen=True, kw_only=True)
class HandMotionOptions(HandOptions):
    """Which hand, and who answers for what it does."""

    yes: Flag = False
    """Ask nobody: for scripts, with an emulated hand, or where nobody and nothing is in the hand."""
