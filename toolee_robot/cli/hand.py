"""Read, open or close the hand of a station file, or clear its faults, without a job.

The arm is neither asked nor moved.

Example: toolee hand state --station lab.yaml
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from toolee_robot.cli.output import Flag, JsonOption, confirm_typed, require_terminal
from toolee_robot.errors import DeviceError, UserError

if TYPE_CHECKING:
    from toolee_robot.frames import Array
    from toolee_robot.hal import Hand, HandState
    from toolee_robot.station import HandConfig

_SETTLED = 0.2
"""Time after which the hand's judgement whether it holds something is averaged over enough readings [s]."""
_MAX_AGE = 0.5
"""Largest age of the reading that is shown [s]."""
_PERIOD = 0.2
"""Time between two tables of efforts [s]."""
_TOUCH_RATIO = 2.0
"""A motor touches when its effort is so many times the largest of the empty hand's."""


@dataclass(frozen=True, kw_only=True)
class HandOptions(JsonOption):
    """Which hand."""

    station: Annotated[Path, tyro.conf.arg(metavar="YAML")]
    """The station file. Only its section `hand` is used."""
    port: Annotated[str | None, tyro.conf.arg(metavar="PORT", help_behavior_hint="(default: hand.port)")] = None
    """Port of the hand instead of the file's, such as that of `toolee emulate hand`."""

    def hand(self) -> HandConfig:
        """What the station file says of the hand, at the port that is meant; a tool mount is refused."""
        from toolee_robot.robots import MOUNT
        from toolee_robot.station import load_station

        hand = load_station(self.station).hand
        if hand.model == MOUNT:
            raise UserError(
                f"{self.station} has a tool mount, which has no motors or sensors. Fix and remove the tool by hand"
            )
        return hand if self.port is None else replace(hand, port=self.port)

    @contextmanager
    def connected(self, config: HandConfig, console: Console) -> Iterator[Hand]:
        """Context with the hand; connecting moves nothing, and leaving it stops the fingers."""
        from toolee_robot.devices.hands import open_hand
        from toolee_robot.runtime.clock import HostClock

        console.print(f"[dim]asking the hand at {escape(str(config.port))}[/dim]")
        with open_hand(config, HostClock()) as hand:
            time.sleep(_SETTLED)
            yield hand

    def show(self, hand: Hand, state: HandState, console: Console) -> None:
        """Show a state: joints [deg], forces [N], hold, temperature, fault; JSON has radians."""
        table = Table("part", "value", box=None, pad_edge=False)
        table.columns[1].justify = "right"
        for name, angle in zip(hand.joint_names, np.rad2deg(state.joints.q), strict=True):
            table.add_row(escape(name), f"{angle:.1f} deg")
        for finger, force in state.contact_forces.items():
            table.add_row(f"force, {escape(finger)}", f"{force:.1f} N")
        table.add_row("holds something", "yes" if state.holding else "no")
        table.add_row("temperature", "not told" if state.temperature is None else f"{state.temperature:.0f} °C")
        table.add_row("fault", f"[red]{escape(state.fault)}[/red]" if state.fault else "none")
        console.print(table)
        figures = {
            "joints": dict(zip(hand.joint_names, state.joints.q.tolist(), strict=True)),
            "contact_forces": state.contact_forces,
            "holding": state.holding,
            "temperature": state.temperature,
            "fault": state.fault,
        }
        self.tell(figures)


@dataclass(frozen=True, kw_only=True)
class HandMotionOptions(HandOptions):
    """Which hand, and who answers for what it does."""

    yes: Flag = False
    """Do not ask: for scripts, if the hand is emulated or empty and nobody is near."""

    def move(
        self,
        question: str,
        done: str,
        move: Callable[[Hand], None],
        check: Callable[[Hand], object] = lambda _: None,
    ) -> int:
        """Check the hand, ask a person, move the fingers, and show the state."""
        console = self.console
        config = self.hand()  # a mount is refused before anybody is asked for a terminal
        if not self.yes:
            require_terminal("a person confirms each motion of the hand", "--yes asks nobody")
        with self.connected(config, console) as hand:
            check(hand)
            if hand.state(_MAX_AGE).holding:
                console.print("The hand holds something.")
            if not self.yes:
                confirm_typed(console, question)
            move(hand)
            time.sleep(_SETTLED)
            state = hand.state(_MAX_AGE)
            console.print(done)
            self.show(hand, state, console)
        return 0


@dataclass(frozen=True, kw_only=True)
class State(HandOptions):
    """Show the hand's joints, forces, hold, temperature and fault.

    Example: toolee hand state --station lab.yaml

    Nothing is moved. Exit code 1: the hand has a fault, or does not answer. Angles in --json are in radians.
    """

    def run(self) -> int:
        console = self.console
        with self.connected(self.hand(), console) as hand:
            state = hand.state(_MAX_AGE)
            self.show(hand, state, console)
        return int(bool(state.fault))


@dataclass(frozen=True, kw_only=True)
class Open(HandMotionOptions):
    """Open the hand, for instance to take the tool out.

    Example: toolee hand open --station lab.yaml

    A person holds the tool and confirms first, because the hand drops it. The arm does not move. Ctrl-C stops the
    fingers.
    """

    def run(self) -> int:
        return self.move(
            "The hand drops what it holds when it opens. Hold the tool, fingers away from the hand. Open?",
            "The hand is open.",
            lambda hand: hand.open(),
        )


@dataclass(frozen=True, kw_only=True)
class Close(HandMotionOptions):
    """Close the hand until it holds something or is shut.

    Example: toolee hand close --station lab.yaml --port hand.port

    A person confirms first. The arm does not move. Ctrl-C stops the fingers, which keep their hold. An Ability Hand
    may let go when the command ends.
    """

    def run(self) -> int:
        return self.move(
            "The fingers close until they hold something or are shut. Keep your fingers away. Close?",
            "The hand is closed.",
            lambda hand: hand.close(),
        )


@dataclass(frozen=True, kw_only=True)
class ClearFaults(HandMotionOptions):
    """Clear the hand's faults, such as a stall.

    Example: toolee hand clear-faults --station lab.yaml

    A person finds the cause and confirms first. Only the Inspire RH56 keeps such faults. Exit code 1: a fault is left,
    such as heat. The command moves nothing, but a freed finger may continue to its last target.
    """

    def run(self) -> int:
        return self.move(
            "Find the cause of the fault, and remove what blocks the hand. A freed finger may move: keep your "
            "fingers away. Clear the faults?",
            "The hand has no fault.",
            _clear_faults,
            _clearing,
        )


def _clearing(hand: Hand) -> Callable[[], None]:
    """How a hand's faults are cleared; one that clears none is refused before a person is asked."""
    from toolee_robot.hal import ClearsFaults

    if not isinstance(hand, ClearsFaults):
        raise UserError(
            "this hand's driver cannot clear faults. Read `toolee hand state`, remove the cause, and power-cycle "
            "the hand if the fault stays"
        )
    return hand.clear_faults


def _clear_faults(hand: Hand) -> None:
    _clearing(hand)()
    time.sleep(_SETTLED)
    if fault := hand.state(_MAX_AGE).fault:
        raise DeviceError(
            f"the hand still has a fault ({fault}). Let a hot hand cool down, remove what blocks a finger, then "
            "clear again. If a motor has failed, ask the hand's maker"
        )


@dataclass(frozen=True, kw_only=True)
class Efforts(HandOptions):
    """Show a Shadow Hand's motor efforts, present and largest.

    Example: toolee hand efforts --station lab.yaml --seconds 60

    The command moves nothing. Open and close the empty hand with the maker's software: `touch` of `hand.efforts` is
    twice the largest effort. Close it on the handle to read `grip`. Pull at the first finger's tip with a spring
    balance for `newtons_per_unit`.
    """

    seconds: Annotated[float, tyro.conf.arg(metavar="S")] = 30.0
    """How long to watch."""

    def run(self) -> int:
        if not 0.0 < self.seconds < np.inf:
            raise UserError("--seconds must be a finite number above 0")
        from toolee_robot.devices.hands import efforts_of
        from toolee_robot.robots.hands.shadow import MOTORS
        from toolee_robot.runtime.clock import HostClock

        console = self.console
        now = largest = np.zeros(len(MOTORS))
        end, shown = time.monotonic() + self.seconds, -np.inf
        with (
            closing(efforts_of(self.hand(), HostClock())) as readings,
            Live(console=console, auto_refresh=False) as live,
        ):
            for now in readings:
                largest = np.maximum(largest, now)
                if time.monotonic() - shown >= _PERIOD:
                    live.update(_effort_table(MOTORS, now, largest), refresh=True)
                    shown = time.monotonic()
                if time.monotonic() >= end:
                    break
            live.update(_effort_table(MOTORS, now, largest), refresh=True)
        motor = MOTORS[int(np.argmax(largest))]
        console.print(
            f"\nThe largest effort was {largest.max():.0f}, of {motor}. If the hand was empty and moved freely, set "
            f"hand.efforts.touch to {_TOUCH_RATIO * largest.max():.0f}."
        )
        both = {"now": now, "largest": largest}
        self.tell({name: dict(zip(MOTORS, values.tolist(), strict=True)) for name, values in both.items()})
        return 0


COMMANDS = {"hand": {"state": State, "open": Open, "close": Close, "clear-faults": ClearFaults, "efforts": Efforts}}


def _effort_table(motors: tuple[str, ...], now: Array, largest: Array) -> Table:
    table = Table("motor", "now", "largest", box=None, pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"
    for motor, *values in zip(motors, now, largest, strict=True):
        table.add_row(motor, *(f"{value:.0f}" for value in values))
    return table
