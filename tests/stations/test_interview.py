"""The interview: everything that a lab must measure is asked, once, and an answer in another unit is noticed."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from tests.examples import examples
from toolee_robot.config import ToolEnvelope, load_lab_station
from toolee_robot.errors import UserError
from toolee_robot.stations.interview import Question, put, questions
from toolee_robot.stations.lab import Purpose, check_purpose

LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"


def _answers(data: dict[str, Any], said: dict[str, Any]) -> list[str]:
    """Answer every question with what a file says; the questions that were asked."""
    asked = []
    while (question := next(iter(questions(data)), None)) is not None:
        value: Any = said
        for name in question.path:
            value = value[name]
        text = " ".join(map(str, value)) if isinstance(value, list) else str(value)
        put(data, question.path, question.parse(text))
        asked.append(question.name)
    return asked


def test_what_was_answered_is_a_whole_station(tmp_path: Path) -> None:
    said, data = yaml.safe_load(LAB.read_text()), dict[str, Any](version=2)
    del said["scene"]["obstacles"]  # boxes beyond those that every station has are written into the file by hand
    asked = _answers(data, said)
    assert len(set(asked)) == len(asked)
    path = tmp_path / "lab.yaml"
    path.write_text(yaml.safe_dump(data))
    config = load_lab_station(path)
    check_purpose(config, Purpose.CALIBRATION)
    assert {name: data[name] for name in data} == {name: said[name] for name in data}
    assert set(said) - set(data) == {"servo", "calibration"}, "these are measured by commands of their own"
    assert list(questions(data)) == []


def test_a_hand_is_asked_how_it_is_screwed_on_and_what_it_weighs() -> None:
    data: dict[str, Any] = {"hand": {"model": "inspire_rh56"}}
    names = {question.name for question in questions(data)}
    assert {"hand.port", "hand.weighed.mass", "hand.mounting.fingers", "hand.strap_force"} <= names
    assert not any(name.startswith("hand.mount.") for name in names)


@pytest.mark.parametrize(
    ("name", "answer", "code", "words"),
    [
        ("camera.position", "950 -620 850", "user.answer_unit", "millimetres"),
        ("work.stand_height", "200", "user.answer_unit", "millimetres"),
        ("scene.home", "0 -90 90 -90 -90 0", "user.answer_unit", "degrees"),
        ("tool.mass", "500", "user.answer_unit", "grams"),
        ("work.nail_diameter", "2.2", "user.answer_unit", "millimetres"),
        ("camera.position", "0.95 -0.62", "user.answer", "3 numbers are needed, 2 were given"),
        ("work.nail_diameter", "-0.002", "user.answer", "greater than 0"),
        ("work.nail_diameter", "two", "user.answer", "a number is needed"),
        ("frame", "base", "user.answer", "pendant_base"),
        ("person.door_closed_input", "18", "user.answer", "17"),
        ("person.door_closed_input", "none", "user.answer", "a number is needed"),
    ],
)
def test_an_answer_that_cannot_be_is_asked_again(name: str, answer: str, code: str, words: str) -> None:
    question = next(q for q in questions({}) if q.name == name)
    with raises(UserError, code) as caught:
        question.parse(answer)
    assert words in str(caught.value)


def test_a_list_may_be_copied_from_a_file() -> None:
    question = next(q for q in questions({}) if q.name == "scene.home")
    assert question.form == "6 numbers"
    assert question.parse("[0.0, -1.9, 1.9, -1.57, -1.57, 0.0]") == [0.0, -1.9, 1.9, -1.57, -1.57, 0.0]


def test_what_would_stay_the_simulations_unseen_is_offered_and_written_down() -> None:
    offered = {question.name: question for question in questions({}) if question.offered}
    assert {"strike.speed", "work.block_xy", "tool_envelope.head_radius"} <= set(offered)
    envelope = {q.path[-1]: q.parse(q.offered) for q in offered.values() if q.path[0] == "tool_envelope"}
    assert ToolEnvelope(**envelope) == ToolEnvelope()
    assert offered["work.block_xy"].parse(offered["work.block_xy"].offered) is None
    assert offered["work.block_xy"].parse("0.75, 0.10") == [0.75, 0.10]
    assert offered["work.block_xy"].form == "2 numbers"
    assert offered["strike.speed"].parse(offered["strike.speed"].offered) == 0.4


def test_a_contact_that_is_not_there_is_none() -> None:
    question = next(q for q in questions({}) if q.name == "person.door_open_input")
    assert question.optional
    assert question.parse("none") is None


@given(st.text(max_size=30))
@examples(200)
def test_whatever_is_typed_is_a_value_or_an_answer_that_says_why_not(text: str) -> None:
    for question in _ALL:
        with suppress(UserError):
            question.parse(text)


_ALL: list[Question] = list(questions({"hand": {"model": "mount"}}))
