"""What the `toolee hand` commands do: connect, ask, move, tell the state."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from toolee_robot.cli.hand.options import HandMotionOptions, HandOptions
from toolee_robot.cli.output import json_line
from toolee_robot.cli.terminal import confirm_typed, require_terminal
from toolee_robot.errors import DeviceError, UserError
from toolee_robot.hal import ClearsFaults, Hand, HandState
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import HandConfig
from toolee_robot.stations.hand import open_hand

SETTLED = 0.2
"""Time after which the hand's judgement whether it holds something is averaged over enough readings [s]."""
MAX_AGE = 0.5
"""Largest age of the reading that is told [s]."""


@contextmanager
def connected(config: HandConfig, console: Console) -> Iterator[Hand]:
    """Connect to the hand, which moves nothing; leaving the context stops the fingers.

    Args:
        config: What the station file says of the hand.
        console: The console.

    Yields:
        The hand.

    Raises:
        ConfigError: The station file does not fit, or there is no driver.
        DeviceError: The hand does not answer, or another program has its port.
    """
    clock = HostClock()
    with ExitStack() as stack:
        with console.status(f"asking the hand at {escape(str(config.port))}"):
            hand = stack.enter_context(open_hand(config, clock))
            clock.sleep(SETTLED)
        yield hand


def run_motion(
    options: HandMotionOptions,
    question: str,
    done: str,
    move: Callable[[Hand], None],
    check: Callable[[Hand], None] | None = None,
) -> int:
    """Ask a person, then move the fingers and tell the state.

    Args:
        options: Which hand, and whether a person is asked.
        question: What the person is to do before, and what will happen.
        done: What is told after it.
        move: Moves the fingers.
        check: Refuses a hand that cannot do it, before a person is asked; None where every hand can.

    Returns:
        The exit code.

    Raises:
        UserError: Nobody can be asked.
        PersonNearError: It was not confirmed.
        TooleeError: What `HandOptions.hand`, `connected` and the motion raise.
    """
    console = Console(stderr=options.json, highlight=False)
    config = options.hand()  # a mount is refused before anybody is asked for a terminal
    if not options.yes:
        require_terminal("a person confirms each motion of the hand", "--yes asks nobody")
    with connected(config, console) as hand:
        if check is not None:
            check(hand)
        if hand.state(MAX_AGE).holding:
            console.print("The hand holds something.")
        if not options.yes:
            confirm_typed(console, question)
        move(hand)
        HostClock().sleep(SETTLED)
        state = hand.state(MAX_AGE)
        console.print(done)
        tell(options, hand, state, console)
    return 0


def refuse_without_clearing(hand: Hand) -> None:
    """Refuse a hand whose driver clears no faults.

    Args:
        hand: The hand.

    Raises:
        UserError: It is one (`user.no_clear_faults`).
    """
    if not isinstance(hand, ClearsFaults):
        raise UserError(
            "the driver of this hand clears no faults: look what `toolee hand state` says, take away the cause, and "
            "switch the hand off and on if the fault stays",
            code="user.no_clear_faults",
        )


def clear_faults(hand: Hand) -> None:
    """Clear a hand's faults and see whether they are gone.

    Args:
        hand: The hand.

    Raises:
        UserError: Its driver clears no faults (`user.no_clear_faults`).
        DeviceError: It does not take it, or a fault is left (`device.hand_fault_left`).
    """
    refuse_without_clearing(hand)
    assert isinstance(hand, ClearsFaults)
    hand.clear_faults()
    HostClock().sleep(SETTLED)
    if fault := hand.state(MAX_AGE).fault:
        raise DeviceError(
            f"the hand still has a fault ({fault}): heat has to go by itself, and what blocks a finger has to be taken "
            "away first, then clear again; a motor that has failed is for the hand's maker",
            code="device.hand_fault_left",
        )


def tell(options: HandOptions, hand: Hand, state: HandState, console: Console) -> None:
    """Show a state, and print it for --json.

    Args:
        options: Whether JSON is asked for.
        hand: The hand.
        state: Its state.
        console: The console.
    """
    console.print(_table(hand, state))
    if options.json:
        print(json_line(_figures(hand, state)), flush=True)


def _table(hand: Hand, state: HandState) -> Table:
    """Format a state: joints [deg], forces [N], hold, temperature, fault."""
    table = Table("part", "value", box=None, pad_edge=False)
    table.columns[1].justify = "right"
    for name, angle in zip(hand.joint_names, np.rad2deg(state.joints.q), strict=True):
        table.add_row(escape(name), f"{angle:.1f} deg")
    for finger, force in state.contact_forces.items():
        table.add_row(f"force, {escape(finger)}", f"{force:.1f} N")
    table.add_row("holds something", "yes" if state.holding else "no")
    table.add_row("temperature", "not told" if state.temperature is None else f"{state.temperature:.0f} °C")
    table.add_row("fault", f"[red]{escape(state.fault)}[/red]" if state.fault else "none")
    return table


def _figures(hand: Hand, state: HandState) -> dict[str, object]:
    """A state for --json: joints by name [rad], forces by finger [N], temperature [deg C], fault, empty for none."""
    return {
        "joints": dict(zip(hand.joint_names, state.joints.q.tolist(), strict=True)),
        "contact_forces": state.contact_forces,
        "holding": state.holding,
        "temperature": state.temperature,
        "fault": state.fault,
    }
