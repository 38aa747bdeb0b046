"""The interview: everything that a lab must measure is asked, once, and an answer in another unit is noticed."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from tests.examples import examples
from toolee_robot.devices.hands import wired_hand
from toolee_robot.errors import ConfigError, UserError
from toolee_robot.robots.hands import HAND_FILES
from toolee_robot.station import ToolEnvelope, load_lab_station, sim_station
from toolee_robot.stations.interview import Question, put, questions
from toolee_robot.stations.lab import Purpose, check_purpose
from toolee_robot.stations.open_fields import open_fields
from toolee_robot.types import HandEfforts

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


def test_every_hand_is_asked_for_what_its_driver_and_a_job_need() -> None:
    """What `open_hand` and `check_purpose` refuse to be without."""
    for model in HAND_FILES:
        kind = wired_hand(model)
        assert kind is not None
        names = {question.name for question in questions({"hand": {"model": model}})}
        efforts = {f"hand.efforts.{field.name}" for field in fields(HandEfforts)}
        assert "hand.port" in names
        assert (names & efforts == efforts) is kind.measured_efforts, model


def test_a_file_without_the_efforts_of_its_hand_is_not_complete(tmp_path: Path) -> None:
    hand = yaml.safe_load((LAB.parent / "shadow.yaml").read_text())["hand"]
    hand["weighed"] = {"mass": 4.3, "center_of_mass": [0.0, 0.0, 0.17]}
    path, said = tmp_path / "lab.yaml", yaml.safe_load(LAB.read_text()) | {"hand": hand}
    path.write_text(yaml.safe_dump(said))
    check_purpose(load_lab_station(path))
    del hand["efforts"]
    path.write_text(yaml.safe_dump(said))
    with raises(ConfigError, "config.station_lacks") as lacking:
        check_purpose(load_lab_station(path))
    assert "give hand.efforts" in str(lacking.value)
    (entry,) = (entry for entry in open_fields(said, path) if entry.section == "hand.efforts")
    assert entry.names == ("touch", "grip", "newtons_per_unit")
    assert "toolee hand efforts" in entry.source


@pytest.mark.parametrize(
    ("driver", "asked", "tells_its_lens"),
    [("realsense", set(), True), ("orbbec", set(), True), ("airo", {"camera_class"}, False),
     ("recorded", {"folder"}, False)],
)  # fmt: skip
def test_a_camera_is_asked_what_its_driver_needs_and_does_not_tell(
    driver: str, asked: set[str], tells_its_lens: bool
) -> None:
    names = {question.name for question in questions({"camera": {"device": {"driver": driver}}})}
    own = {"camera_class", "folder"}
    assert {name for name in own if f"camera.device.{name}" in names} == asked
    assert ("camera.distortion" in names) is not tells_its_lens
    assert {"camera.device.serial", "camera.device.least_range", "camera.fx", "camera.width"} <= names


@pytest.mark.parametrize(
    ("name", "answer", "code", "words"),
    [
        ("camera.position", "950 -620 850", "user.answer", "millimetres"),
        ("work.stand_height", "200", "user.answer", "millimetres"),
        ("scene.home", "0 -90 90 -90 -90 0", "user.answer", "degrees"),
        ("tool.mass", "500", "user.answer", "grams"),
        ("work.nail_diameter", "2.2", "user.answer", "millimetres"),
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
    assert ToolEnvelope(**envelope) == sim_station().tool_envelope
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
