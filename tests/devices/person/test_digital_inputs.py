"""The person on digital inputs: whatever is stuck, unplugged or old reads as occupied and not held."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.errors import raises
from tests.examples import timed
from tests.rigs.panel import ALL, DOOR_CLOSED, ONE_CONTACT, SWITCH_HELD, TWO_CONTACTS, Panel, later
from toolee_robot.devices.person import DigitalInputPerson, check_inputs, open_person
from toolee_robot.errors import ConfigError, PersonNearError
from toolee_robot.findings import Level
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.devices.arm import SimArm
from toolee_robot.station import PersonConfig, load_station, sim_station
from toolee_robot.tasks.common.watches import PersonProof

pytestmark = pytest.mark.realtime(light=True)

CLOCK = HostClock()
said: list[str] = []
"""The prompts."""


@contextmanager
def at(panel: Panel, config: PersonConfig = TWO_CONTACTS) -> Iterator[DigitalInputPerson]:
    with DigitalInputPerson(config, panel.read, CLOCK, said.append) as person:
        yield person


def eventually(condition: Callable[[], bool], within: float = 1.5) -> bool:
    end = time.monotonic() + within
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return condition()


@timed
@pytest.mark.parametrize("config", [ONE_CONTACT, TWO_CONTACTS])
def test_door_and_switch_read_as_they_are(config: PersonConfig, timed: bool) -> None:
    panel = Panel()
    with at(panel, config) as person:
        assert person.zone_occupied(), "nothing was read yet"
        panel.closed = True
        assert eventually(lambda: not person.zone_occupied())
        assert not person.hold_to_run_held()
        panel.held = True
        assert eventually(person.hold_to_run_held)
        panel.closed = panel.held = False
        assert eventually(person.zone_occupied, 0.2 if timed else 1.5)
        assert eventually(lambda: not person.hold_to_run_held(), 0.2 if timed else 1.5)
    assert person.zone_occupied()


@timed
@pytest.mark.parametrize(
    ("break_it", "fault"),
    [
        (lambda panel: setattr(panel, "low", ALL), "unplugged"),
        (lambda panel: setattr(panel, "high", ALL), "stuck"),
        (lambda panel: setattr(panel, "dead", True), ""),
    ],
    ids=["unplugged", "short circuit", "no data"],
)
def test_broken_wiring_reads_as_occupied_and_not_held(
    break_it: Callable[[Panel], None], fault: str, timed: bool
) -> None:
    panel = Panel()
    panel.closed = panel.held = True
    with at(panel) as person:
        assert eventually(lambda: person.hold_to_run_held() and not person.zone_occupied())
        break_it(panel)
        assert eventually(lambda: person.zone_occupied() and not person.hold_to_run_held(), 0.3 if timed else 1.5)
        assert eventually(lambda: len(person.faults) == (2 if fault else 0))
        assert all(fault in text for text in person.faults)
        panel.high = panel.low = 0
        panel.dead = False
        if fault:
            time.sleep(0.2)
            assert person.zone_occupied(), "the wiring is mended; nobody has operated it since"


def test_a_question_is_confirmed_by_a_press_only() -> None:
    panel = Panel()
    with at(panel) as person:
        assert not person.confirm_swing("swing?", 0.4), "nobody answers"
        later(panel.press)
        assert person.confirm_swing("swing?", 2.0)
        panel.held = True
        assert not person.take_tool("take it", 0.4), "a switch that is held already, or is stuck"
    assert "press it" in said[-1]


def test_the_press_before_the_door_is_closed_releases_nobody() -> None:
    panel = Panel()
    with at(panel) as person:
        later(panel.press)
        assert not person.release("step back", 0.8)


@pytest.mark.parametrize(
    ("stuck", "missing"), [(DOOR_CLOSED, "nobody was seen within reach"), (SWITCH_HELD, "never seen released")]
)
def test_a_single_contact_that_is_stuck_never_proves_itself(stuck: int, missing: str) -> None:
    panel = Panel()
    panel.high = stuck
    panel.closed = True
    with at(panel, ONE_CONTACT) as person:
        proof = PersonProof(person)
        assert eventually(lambda: not person.zone_occupied())
        proof.hold_to_run_held()
        with raises(PersonNearError, says="the person's inputs cannot be trusted"):
            proof.zone_occupied()
        assert any(missing in text for text in proof.missing)


def test_a_person_that_always_answers_no_is_not_believed() -> None:
    """LAB.md, defect 12: `return False` is one line."""

    class Nobody(DigitalInputPerson):
        def zone_occupied(self) -> bool:
            return False

    panel = Panel()
    with Nobody(TWO_CONTACTS, panel.read, CLOCK, said.append) as person:
        proof = PersonProof(person)
        later(panel.hold)
        assert proof.hold_switch("hold it", 2.0)
        with raises(PersonNearError, says="the person's inputs cannot be trusted"):
            proof.zone_occupied()


def test_what_is_assumed_for_want_of_data_is_no_change_that_was_seen() -> None:
    """A door whose contact is stuck closed reads as open while the link is silent; that proves nothing."""
    panel = Panel()
    panel.high = DOOR_CLOSED
    panel.dead = True
    with at(panel, ONE_CONTACT) as person:
        proof = PersonProof(person)
        assert proof.zone_occupied()
        assert not proof.hold_to_run_held()
        panel.dead = False
        assert eventually(person.readings_certain)
        later(panel.hold)
        assert proof.hold_switch("hold it", 2.0)
        with raises(PersonNearError, says="the person's inputs cannot be trusted"):
            proof.zone_occupied()
        panel.dead = True
        assert eventually(person.zone_occupied)
        assert proof.zone_occupied()
        panel.dead = False
        assert eventually(person.readings_certain)
        with raises(PersonNearError, says="the person's inputs cannot be trusted"):
            proof.zone_occupied()


# -- doctor, station file --------------------------------------------------------------------------------------------


def obey(panel: Panel, prompts: list[str]) -> Callable[[str], None]:
    """A person who does as they are told, as far as the wiring lets it be seen."""

    def act(prompt: str) -> None:
        prompts.append(prompt)
        if "door" in prompt:
            panel.closed = "close" in prompt
        else:
            panel.held = "press" in prompt

    return act


@pytest.mark.parametrize("config", [pytest.param(ONE_CONTACT, marks=pytest.mark.nightly), TWO_CONTACTS])
@pytest.mark.parametrize("closed", [True, False])
def test_doctor_sees_each_change_once(config: PersonConfig, closed: bool) -> None:
    panel, prompts = Panel(), list[str]()
    panel.closed = closed
    with at(panel, config) as person:
        found = list(check_inputs(person, CLOCK, obey(panel, prompts), 1.0))
    assert [(f.level, f.name) for f in found] == [(Level.OK, "door"), (Level.OK, "hold-to-run switch")]
    assert panel.closed, "a job begins with a closed door"
    assert len(prompts) == (4 if closed else 5), "what is so already is not asked for"
    assert "within 1 s" in prompts[0]


@pytest.mark.parametrize(
    ("config", "broken", "named"),
    [
        (TWO_CONTACTS, {"low": ALL}, "low: unplugged"),
        *(
            pytest.param(*case, marks=pytest.mark.nightly)
            for case in (
                (ONE_CONTACT, {"high": DOOR_CLOSED | SWITCH_HELD}, "stays high: stuck"),
                (ONE_CONTACT, {"low": ALL}, "stays low: unplugged"),
                (TWO_CONTACTS, {"high": DOOR_CLOSED | SWITCH_HELD}, "high: one is stuck"),
                (TWO_CONTACTS, {"dead": True}, "no data"),
            )
        ),
    ],
)
def test_doctor_names_what_is_stuck_or_unplugged(config: PersonConfig, broken: dict[str, Any], named: str) -> None:
    panel = Panel()
    panel.closed = True
    for name, value in broken.items():
        setattr(panel, name, value)
    with at(panel, config) as person:
        found = list(check_inputs(person, CLOCK, obey(panel, []), 0.8))
    assert [(f.level, f.name) for f in found] == [(Level.FAIL, "door"), (Level.FAIL, "hold-to-run switch")]
    assert all(named in f.message and f.remedy for f in found), found


def test_a_fault_of_the_switch_is_none_of_the_door() -> None:
    panel = Panel()
    panel.high = SWITCH_HELD
    with at(panel) as person:
        found = list(check_inputs(person, CLOCK, obey(panel, []), 0.8))
    assert [f.level for f in found] == [Level.OK, Level.FAIL]


def test_a_station_file_without_a_person_has_none(tmp_path: Path) -> None:
    arm: SimArm = SimArm.__new__(SimArm)  # never asked
    with raises(ConfigError, says="the station file has no `person`"):
        open_person(sim_station(), arm, CLOCK, print)
    (tmp_path / "lab.yaml").write_text("person: {door_closed_input: 0, hold_to_run_input: 2}")
    with pytest.raises(ConfigError, match="door_open_input"):
        load_station(tmp_path / "lab.yaml")
    (tmp_path / "lab.yaml").write_text(
        "person: {door_closed_input: 0, door_open_input: null, hold_to_run_input: 2, hold_to_run_released_input: null}"
    )
    assert load_station(tmp_path / "lab.yaml").person == ONE_CONTACT
    with pytest.raises(ValueError, match="twice"):
        replace(ONE_CONTACT, hold_to_run_input=0)
