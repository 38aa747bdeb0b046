"""Numbers go into a station file; what a person wrote around them stays."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from toolee_robot.errors import ConfigError
from toolee_robot.runtime.yaml_edit import set_fields

VALUES = {"gain": 800.0, "lookahead": 0.06, "lag": 0.071}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "# a lab\narm:\n  model: UR10e  # the new one\n",
        "arm: {model: UR10e}",
        "servo:\n  # measured in May\n  gain: 300   # gentle\n  watchdog: 5.0\narm: {model: UR10e}  # new\n",
        "servo: {gain: 300}  # gentle\n",
        "servo: {}\n",
        "arm:\n    model: UR10e\nservo:\n    lag: null\n    gain: 1\n\n# the end\n",
    ],
)
def test_the_fields_are_set_and_the_rest_stays(tmp_path: Path, text: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    before = yaml.safe_load(text) or {}
    set_fields(path, "servo", VALUES)
    after = path.read_text()
    assert yaml.safe_load(after) == {**before, "servo": {**(before.get("servo") or {}), **VALUES}}
    for comment in (line.partition("#")[2] for line in text.splitlines()):
        assert comment in after
    set_fields(path, "servo", VALUES)
    assert path.read_text() == after


@pytest.mark.parametrize("text", ["{arm: {model: UR10e}}", "servo: fast\n", "servo: &a {gain: 1}\nother: *a\n"])
def test_a_layout_that_cannot_be_edited_is_left_alone(tmp_path: Path, text: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    with raises(ConfigError, code="config.not_editable"):
        set_fields(path, "servo", VALUES)
    assert path.read_text() == text


@given(st.dictionaries(st.sampled_from(["gain", "lag", "lookahead"]), st.floats(0, 1e4).map(lambda x: float(f"{x:g}"))))
def test_any_numbers_are_read_back(tmp_path_factory: pytest.TempPathFactory, values: dict[str, float]) -> None:
    path = tmp_path_factory.mktemp("edit") / "lab.yaml"
    path.write_text("servo:\n  gain: 300  # gentle\n")
    set_fields(path, "servo", values)
    assert yaml.safe_load(path.read_text()) == {"servo": {"gain": 300, **values}}


@pytest.mark.parametrize(
    "text",
    [
        "work:\n  nails:  # a row\n    - {name: left, xy: [0.7, 0.1]}  # first\n    - {name: right, xy: [0.8, 0.1]}\n",
        "work: {nails: [{name: left, xy: [0, 0]}, {xy: [1, 1], name: right, length: 0.03}]}\n",
        "work:\n  nails:\n    - name: left\n      xy: [0.7, 0.1]\n    - name: right\n      length: 0.03  # long\n",
    ],
)
def test_a_field_is_set_in_the_record_of_that_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    left, right = yaml.safe_load(text)["work"]["nails"]
    set_fields(path, "work", {"xy": [0.75, -0.125]}, ("nails", "right"))
    after = path.read_text()
    assert yaml.safe_load(after) == {"work": {"nails": [left, {**right, "xy": [0.75, -0.125]}]}}
    for comment in (line.partition("#")[2] for line in text.splitlines()):
        assert comment in after


@pytest.mark.parametrize("text", ["", "work: {}\n", "work:\n  nails: []\n", "work:\n  nails:\n    - {name: left}\n"])
def test_a_record_that_is_not_there_is_not_added(tmp_path: Path, text: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    with raises(ConfigError, code="config.not_editable"):
        set_fields(path, "work", {"xy": [0.75, -0.125]}, ("nails", "right"))
    assert path.read_text() == text
