"""A contact is made only when every reading of a while says so; every doubt reads as not made."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from toolee_robot.devices.person import DEBOUNCE, DISCREPANCY, Contact

TICK, GAP = 0.01, 0.1
MADE, BROKEN, UNPLUGGED, STUCK = 0b01, 0b10, 0b00, 0b11


def fed(contact: Contact, *runs: tuple[int, float], start: float = 0.0) -> float:
    now = start
    for bits, duration in runs:
        for _ in range(round(duration / TICK)):
            contact.update(bits, now)
            now += TICK
    return now


def test_it_bounces_into_being_made() -> None:
    door = Contact("door", 0, 1, GAP)
    now = fed(door, (BROKEN, 0.2), (MADE, 0.03), (BROKEN, 0.01), (MADE, DEBOUNCE))
    assert not door.made
    fed(door, (MADE, 0.02), start=now)
    assert door.made


def test_contacts_that_disagree_are_a_fault_until_the_door_was_opened() -> None:
    for bits, expected in ((UNPLUGGED, "unplugged"), (STUCK, "stuck")):
        door = Contact("door", 0, 1, GAP)
        now = fed(door, (MADE, 0.2), (bits, DISCREPANCY + 0.03))
        assert expected in door.fault
        now = fed(door, (MADE, 1.0), start=now)
        assert not door.made, "nobody has opened it since"
        now = fed(door, (BROKEN, 0.2), start=now)
        assert door.broken
        assert not door.fault
        fed(door, (MADE, 0.2), start=now)
        assert door.made


def test_a_single_contact_that_is_unplugged_is_broken() -> None:
    door = Contact("door", 0, None, GAP)
    fed(door, (MADE, 0.2))
    assert door.made
    fed(door, (UNPLUGGED, 0.2), start=0.2)
    assert door.broken


def test_what_cannot_be_read_is_neither() -> None:
    door = Contact("door", 0, 1, GAP)
    now = fed(door, (MADE, 0.2))
    door.lose()
    assert not door.made
    assert not door.broken
    door.update(MADE, now)
    assert not door.made


@given(st.lists(st.tuples(st.sampled_from([MADE, BROKEN, UNPLUGGED, STUCK]), st.floats(0.001, 0.3)), max_size=60))
def test_it_is_never_made_without_its_time(readings: list[tuple[int, float]]) -> None:
    """Whatever comes: made means that the last reading was, and that all over DEBOUNCE were, without a gap."""
    door = Contact("door", 0, 1, GAP)
    now, steady = 1.0, None
    last = now
    for bits, step in readings:
        now += step
        if bits != MADE:
            steady = None
        elif steady is None or now - last > GAP:
            steady = now
        last = now
        door.update(bits, now)
        assert not (door.made and door.broken)
        if door.made:
            assert steady is not None
            assert now - steady >= DEBOUNCE - 1e-9
