"""What can happen to an emulated hand, as lines of text: `heat index 75`, `garbage 3`, `unplug`."""

from __future__ import annotations

from toolee_robot.errors import UserError
from toolee_robot.sim_backend.inspire_hand.emulator import HandEmulator
from toolee_robot.sim_backend.inspire_hand.hand import NAMES, Hand
from toolee_robot.sim_backend.inspire_hand.line_faults import LineFault
from toolee_robot.sim_backend.inspire_hand.motor import Motor

EVENTS = (
    "handle COUNTS, drop, slip COUNTS, heat MOTOR DEGREES, jam MOTOR, free MOTOR, mute, unmute, echo, unplug, show, "
    f"or {', '.join(LineFault)} with a number of replies; a MOTOR is one of {', '.join(NAMES)}"
)
"""The events, for people."""


def happen(emulator: HandEmulator, line: str) -> str:
    """Let something happen.

    Args:
        emulator: The hand.
        line: The event, one of EVENTS.

    Returns:
        What the hand looks like then, for people.

    Raises:
        UserError: There is no such event.
    """
    event, *words = line.split()
    try:
        if event in {*LineFault}:
            emulator.faults.upcoming(LineFault(event), int(*words or "1"))
        elif not _to_line(emulator, event, words):
            emulator.tell(lambda hand: _to_hand(hand, event, words))
    except (ValueError, TypeError, KeyError, StopIteration) as error:
        raise UserError(f"{line.strip()!r} cannot happen: give {EVENTS}", code="user.hand_event") from error
    if not emulator.plugged:
        return "unplugged"
    return ", ".join(f"{name} {angle:.0f}" for name, angle in zip(NAMES, emulator.angles, strict=True))


def _to_line(emulator: HandEmulator, event: str, words: list[str]) -> bool:
    """Let something happen to the line, without parameters; whether there is such an event."""
    if words or event not in ("mute", "unmute", "echo", "unplug", "show"):
        return False
    if event == "unplug":
        emulator.unplug()
    elif event == "echo":
        emulator.faults.echo = True
    elif event != "show":
        emulator.faults.muted = event == "mute"
    return True


def _to_hand(hand: Hand, event: str, words: list[str]) -> None:
    hand.run()
    if event == "drop" and not words:
        hand.hold(None)
    elif event in ("handle", "slip"):
        (counts,) = words
        (hand.hold if event == "handle" else hand.slip)(float(counts))
    else:
        name, *values = words
        motor: Motor = hand.motors[NAMES.index(name)]
        if event == "heat":
            (motor.temperature,) = map(float, values)
        elif event in ("jam", "free") and not values:
            motor.jammed = event == "jam"
        else:
            raise ValueError(event)
