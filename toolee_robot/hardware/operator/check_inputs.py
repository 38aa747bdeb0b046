"""Check that the person's inputs change when a person changes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from toolee_robot.findings import Finding, fail, ok
from toolee_robot.hal import Clock, Person

PERIOD = 0.02
"""Polling period [s]."""


def check_inputs(
    person: Person, clock: Clock, tell: Callable[[str], object], timeout: float = 30.0
) -> Iterator[Finding]:
    """Demand to see each change of door and switch once; nothing is moved.

    Args:
        person: The person at the station; a `DigitalInputPerson` inside its `with` block.
        clock: The station's clock.
        tell: Shows to the person what to do next.
        timeout: Time for each change [s].

    Yields:
        One finding for the door and one for the switch: OK, or FAIL with the change that did not come.
    """
    door = (
        ("open the door", person.zone_occupied, True, "the door was opened, and the input still reads closed"),
        ("close the door", person.zone_occupied, False, "the door was closed, and the input still reads open"),
        ("open the door again", person.zone_occupied, True, "the door was opened, and the input still reads closed"),
    )
    switch = (
        ("release the hold-to-run switch", person.hold_to_run_held, False, "the released switch reads held"),
        ("hold the hold-to-run switch", person.hold_to_run_held, True, "the held switch reads released"),
        ("release it again", person.hold_to_run_held, False, "the released switch reads held"),
    )
    for name, steps in (("door", door), ("hold-to-run switch", switch)):
        for prompt, reading, wanted, otherwise in steps:
            tell(prompt)
            if not _reads(person, reading, wanted, clock, timeout):
                remedy = (
                    "nothing fast may move; look for a stuck, bridged or unplugged contact, and at its input number"
                )
                yield fail(name, otherwise, remedy)
                break
        else:
            yield ok(name, "every change was seen")


def _reads(person: Person, reading: Callable[[], bool], wanted: bool, clock: Clock, timeout: float) -> bool:
    end = clock.now() + timeout
    # A reading that is assumed for want of data shows nothing of the input.
    while not (person.readings_certain() and reading() is wanted):
        if clock.now() > end:
            return False
        clock.sleep(PERIOD)
    return True
