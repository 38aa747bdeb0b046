"""`toolee hand efforts`: what a hand's strain gauges say, for a lab that measures what that means."""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.live import Live
from rich.table import Table

from toolee_robot.cli.hand.options import HandOptions
from toolee_robot.cli.output import json_line
from toolee_robot.errors import UserError
from toolee_robot.frames import Array

PERIOD = 0.2
"""Time between two tables [s]."""
TWICE = 2.0
"""A motor touches when its effort is so many times the largest of the empty hand's."""


@dataclass(frozen=True, kw_only=True)
class Efforts(HandOptions):
    """Show the efforts of a hand's motors, now and at most: `hand.efforts` of a Shadow Hand. Nothing is moved.

    Example: toolee hand efforts --station lab.yaml --seconds 60

    Open and close the empty hand meanwhile with the maker's software: `touch` is twice the largest effort. Then close
    it on the handle for `grip`, and pull at the first finger's tip with a spring balance for `newtons_per_unit`.
    """

    seconds: Annotated[float, tyro.conf.arg(metavar="S")] = 30.0
    """How long to watch."""

    def run(self) -> int:
        if not 0.0 < self.seconds < np.inf:
            raise UserError("--seconds must be more than 0, and finite", code="user.option")
        from toolee_robot.robots.hands.shadow import MOTORS
        from toolee_robot.runtime.clock import HostClock
        from toolee_robot.stations.hand import efforts_of

        console = Console(stderr=self.json, highlight=False)
        now = largest = np.zeros(len(MOTORS))
        end, shown = time.monotonic() + self.seconds, -np.inf
        with (
            closing(efforts_of(self.hand(), HostClock())) as readings,
            Live(console=console, auto_refresh=False) as live,
        ):
            for now in readings:
                largest = np.maximum(largest, now)
                if time.monotonic() - shown >= PERIOD:
                    live.update(_table(MOTORS, now, largest), refresh=True)
                    shown = time.monotonic()
                if time.monotonic() >= end:
                    break
            live.update(_table(MOTORS, now, largest), refresh=True)
        motor = MOTORS[int(np.argmax(largest))]
        console.print(
            f"\nThe largest effort was {largest.max():.0f}, of {motor}. Of a hand that was empty and moved freely: "
            f"hand.efforts.touch is {TWICE * largest.max():.0f}."
        )
        if self.json:
            figures = {"now": _by_motor(MOTORS, now), "largest": _by_motor(MOTORS, largest)}
            print(json_line(figures), flush=True)
        return 0


def _by_motor(motors: tuple[str, ...], values: Array) -> dict[str, float]:
    return dict(zip(motors, values.tolist(), strict=True))


def _table(motors: tuple[str, ...], now: Array, largest: Array) -> Table:
    table = Table("motor", "now", "largest", box=None, pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"
    for motor, *values in zip(motors, now, largest, strict=True):
        table.add_row(motor, *(f"{value:.0f}" for value in values))
    return table
