"""Options that commands share, and their output."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import tyro
from rich.console import Console

from toolee_robot.runtime.json_line import json_line

Flag = Annotated[bool, tyro.conf.arg(help_behavior_hint="")]
"""A flag, off by default."""


@dataclass(frozen=True, kw_only=True)
class JsonOption:
    """A command that prints its result for programs, too."""

    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    @property
    def console(self) -> Console:
        """Where people read."""
        return Console(stderr=self.json, highlight=False)

    def tell(self, figures: Any) -> None:
        """Print figures as JSON, if that is asked for."""
        if self.json:
            print(json_line(figures), flush=True)
