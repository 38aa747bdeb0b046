"""What can happen to an emulated hand, as lines of text: `heat index 75`, `garbage 3`, `unplug`."""

from __future__ import annotations

from typing import Any

from toolee_robot.errors import UserError
from toolee_robot.sim_backend.hand_wire.emulator import HandEmulator
from toolee_robot.sim_backend.hand_wire.line_faults import ACKNOWLEDGE, LineFault, WriteFault


def happen(emulator: HandEmulator[Any], line: str) -> str:
    """Let something happen.

    Args:
        emulator: The hand.
        line: The event.

    Returns:
        What the hand looks like then, for people.

    Raises:
        UserError: There is no such event; the message names those that there are.
    """
    event, *words = line.split()
    try:
        if event in {*LineFault}:
            emulator.faults.upcoming(LineFault(event), int(*words or "1"))
        elif not _to_line(emulator, event, words):
            _to_hand(emulator, event, words)
    except (ValueError, TypeError) as error:
        events = (
            f"handle ANGLE, drop, slip ANGLE, {emulator.events}, {', '.join(emulator.line_events)}, or "
            f"{', '.join(LineFault)} with a number of replies; a MOTOR is one of {', '.join(emulator.motors)}"
        )
        raise UserError(f"{line.strip()!r} cannot happen: give {events}", code="user.hand_event") from error
    if not emulator.plugged:
        return "unplugged"
    return ", ".join(f"{name} {angle:.0f}" for name, angle in zip(emulator.motors, emulator.angles, strict=True))


def _to_line(emulator: HandEmulator[Any], event: str, words: list[str]) -> bool:
    """Let something happen to the line, without parameters; whether there is such an event."""
    if words or event not in emulator.line_events:
        return False
    if event == "unplug":
        emulator.unplug()
    elif event == "echo":
        emulator.faults.echo = True
    elif event in {*WriteFault, ACKNOWLEDGE}:
        emulator.faults.writes = None if event == ACKNOWLEDGE else WriteFault(event)
    elif event != "show":
        emulator.faults.muted = event == "mute"
    return True


def _to_hand(emulator: HandEmulator[Any], event: str, words: list[str]) -> None:
    if event == "drop" and not words:
        emulator.hold(None)
    elif event in ("handle", "slip"):
        (angle,) = words
        (emulator.hold if event == "handle" else emulator.slip)(float(angle))
    else:
        motor = None
        if words and words[0] in emulator.motors:
            motor = emulator.motors.index(words.pop(0))
        emulator.happen(event, motor, *words)
