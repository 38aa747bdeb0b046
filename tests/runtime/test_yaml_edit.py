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
