"""Check that the person's inputs change when a person changes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from toolee_robot.devices.person.digital_inputs import DigitalInputPerson
from toolee_robot.findings import Finding, fail, ok
from toolee_robot.hal import Clock

PERIOD = 0.02
"""Polling period [s]."""
SETTLING = 0.5
"""Time in which a contact that is as it should be at the start is read so [s]; nobody is asked for it then."""


def check_inputs(
    person: DigitalInputPerson, clock: Clock, tell: Callable[[str], object], timeout: float = 30.0
) -> Iterator[Finding]:
    """Demand to see each change of door and switch once; nothing is moved.

    Args:
        person: The person at the station, inside its `with` block.
        clock: The station's clock.
        tell: Shows to the person what to do next.
        timeout: Time for each change [s].

    Yields:
        One finding for the door and one for the switch: OK, or FAIL with the change that did not come and the contact
        that is stuck or unplugged.
    """
    door = ("close the door", "open the door", "close the door again")
    switch = ("release the hold-to-run switch", "press the hold-to-run switch and hold it", "release it")
    yield _check("door", door, person.door_closed, True, person, clock, tell, timeout)
    yield _check("hold-to-run switch", switch, person.switch_pressed, False, person, clock, tell, timeout)


def _check(
    name: str,
    prompts: tuple[str, str, str],
    reading: Callable[[], bool | None],
    at_first: bool,
    person: DigitalInputPerson,
    clock: Clock,
    tell: Callable[[str], object],
    timeout: float,
) -> Finding:
    """Await `reading` as it should be at first, changed, and as at first again; None is no reading."""
    wanted = (at_first, not at_first, at_first)
    settled = _reads(reading, at_first, clock, SETTLING)
    for prompt, state in list(zip(prompts, wanted, strict=True))[int(settled) :]:
        tell(f"{prompt} (within {timeout:.0f} s)")
        if not _reads(reading, state, clock, timeout):
            remedy = "mend it, then look again; nothing fast may move until both are seen to change"
            return fail(name, _cause(name, prompt, reading(), person), remedy)
    return ok(name, "every change was seen")


def _cause(name: str, prompt: str, made: bool | None, person: DigitalInputPerson) -> str:
    """What hinders a change: its fault, no reading, or a contact that stays as it is."""
    asked = f"asked to {prompt}: "
    if fault := next((fault for fault in person.faults if name in fault), ""):
        return asked + fault.partition(";")[0]
    if made is None:
        return asked + "its inputs cannot be read for certain: no data, or contacts that go on bouncing"
    if made:
        return asked + "its input stays high: stuck, bridged, or another one's number"
    return asked + "its input stays low: unplugged, stuck, or another one's number"


def _reads(reading: Callable[[], bool | None], wanted: bool, clock: Clock, timeout: float) -> bool:
    end = clock.now() + timeout
    while reading() is not wanted:
        if clock.now() > end:
            return False
        clock.sleep(PERIOD)
    return True
