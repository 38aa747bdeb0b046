"""The template and its interview: all that a lab must say is in it, once, and an answer in another unit is noticed."""

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
from tests.examples import examples, seldom
from toolee_robot.devices.hands import wired_hand
from toolee_robot.errors import ConfigError, UserError
from toolee_robot.robots.hands import HAND_FILES
from toolee_robot.station import load_lab_station
from toolee_robot.station.schema import StationField
from toolee_robot.stations.lab import Purpose, check_purpose
from toolee_robot.stations.template import (
    OFFERED,
    applicable,
    get,
    open_fields,
    open_questions,
    parse,
    put,
    template,
)
from toolee_robot.types import HandEfforts

LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"


def _answers(data: dict[str, Any], said: dict[str, Any]) -> list[str]:
    """Answer every question with what a file says; the questions that were asked."""
    asked = []
    while open_ones := open_questions(data):
        value = get(said, open_ones[0].name)
        text = (
            " ".join(map(str, value))
            if isinstance(value, list)
            else str(value).lower()
            if value is None
            else str(value)
        )
        put(data, open_ones[0].name, parse(open_ones[0], text))
        asked.append(open_ones[0].name)
    return asked


def _field(name: str, **data: Any) -> StationField:
    return next(field for field in applicable(data) if field.name == name)


def test_what_was_answered_is_a_whole_station(tmp_path: Path) -> None:
    said, data = yaml.safe_load(LAB.read_text()), dict[str, Any](version=3)
    del said["scene"]["obstacles"]  # boxes beyond those that every station has are written into the file by hand
    asked = _answers(data, said)
    assert len(set(asked)) == len(asked)
    path = tmp_path / "lab.yaml"
    path.write_text(yaml.safe_dump(data))
    config = load_lab_station(path)
    check_purpose(config, Purpose.CALIBRATION)
    assert {name: data[name] for name in data} == {name: said[name] for name in data}
    assert yaml.safe_load(template(data)) == data, "the template holds what was answered"
    assert template(yaml.safe_load(template(data))) == template(data)
    assert set(said) - set(data) == {"servo", "calibration"}, "these are measured by commands of their own"
    assert open_questions(data) == []


def test_every_hand_is_asked_for_what_its_driver_and_a_job_need() -> None:
    """What `open_hand` and `check_purpose` refuse to be without."""
    for model in HAND_FILES:
        kind = wired_hand(model)
        assert kind is not None
        names = {question.name for question in open_questions({"hand": {"model": model}})}
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
    with raises(ConfigError, says="the station file lacks what") as lacking:
        check_purpose(load_lab_station(path))
    assert "give hand.efforts" in str(lacking.value)
    (entry,) = (entry for entry in open_fields(said, path) if entry.section == "hand.efforts")
    assert entry.names == ("touch", "grip", "newtons_per_unit")
    assert "toolee hand efforts" in entry.source


@pytest.mark.parametrize(
    ("driver", "asked", "tells_its_lens"),
    [("realsense", set(), True), ("orbbec", set(), True), ("recorded", {"folder"}, False)],
)
def test_a_camera_is_asked_what_its_driver_needs_and_does_not_tell(
    driver: str, asked: set[str], tells_its_lens: bool
) -> None:
    names = {question.name for question in open_questions({"camera": {"device": {"driver": driver}}})}
    assert {"folder"} & {name.removeprefix("camera.device.") for name in names} == asked
    assert ("camera.distortion" in names) is not tells_its_lens
    assert {"camera.device.serial", "camera.device.least_range", "camera.fx", "camera.width"} <= names


@pytest.mark.parametrize(
    ("name", "answer", "words"),
    [
        ("camera.position", "950 -620 850", "millimetres"),
        ("work.stand_height", "200", "millimetres"),
        ("scene.home", "0 -90 90 -90 -90 0", "degrees"),
        ("tool.mass", "500", "grams"),
        ("work.nail_diameter", "2.2", "millimetres"),
        ("camera.position", "0.95 -0.62", "give 3 numbers, not 2"),
        ("work.nail_diameter", "-0.002", "0.0005 to 0.02 m"),
        ("work.nail_diameter", "two", "is not a number"),
        ("frame", "base", "pendant_base"),
        ("person.door_closed_input", "18", "17"),
        ("person.door_closed_input", "none", "is not a number"),
    ],
)
def test_an_answer_that_cannot_be_is_asked_again(name: str, answer: str, words: str) -> None:
    with raises(UserError, says=words):
        parse(_field(name), answer)


def test_what_most_labs_have_alike_is_offered() -> None:
    offered = {name: _field(name) for name in OFFERED}
    assert parse(offered["work.block_xy"], OFFERED["work.block_xy"]) is None
    assert parse(offered["work.block_xy"], "0.75, 0.10") == [0.75, 0.10]
    assert offered["work.block_xy"].kind.startswith("2 numbers")
    assert parse(offered["strike.speed"], OFFERED["strike.speed"]) == 0.4
    assert not any(name.startswith("tool_envelope") for name in OFFERED), "nobody's cylinders are the simulation's"


@pytest.mark.parametrize("model", [*HAND_FILES, "mount"])
@pytest.mark.parametrize("driver", seldom("realsense", "recorded"))
def test_an_empty_template_lacks_everything_and_nothing_in_it_is_wrong(model: str, driver: str, tmp_path: Path) -> None:
    data: dict[str, Any] = {}
    for name, value in (("arm.model", "UR10e"), ("hand.model", model), ("camera.device.driver", driver)):
        put(data, name, value)
    path = tmp_path / "lab.yaml"
    path.write_text(template(data))
    read = yaml.safe_load(path.read_text())
    assert [field.name for field in open_questions(read)] == [field.name for field in open_questions(data)]
    assert all(f"  {field.path[-1]}:" in template(data) or f"#{field.path[-1]}:" in template(data)
               for field in open_questions(data) if field.name != "frame")  # fmt: skip
    with pytest.raises(ConfigError, match=r"camera\.device\.serial: is missing"):
        load_lab_station(path)


@given(st.text(max_size=30))
@examples(200)
def test_whatever_is_typed_is_a_value_or_an_answer_that_says_why_not(text: str) -> None:
    for field in _ALL:
        with suppress(UserError):
            parse(field, text)


_ALL: list[StationField] = open_questions({"hand": {"model": "mount"}})
