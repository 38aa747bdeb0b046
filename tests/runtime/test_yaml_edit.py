"""Numbers go into a station file; what a person wrote around them stays."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from toolee_robot.errors import ConfigError
from toolee_robot.runtime.yaml_edit import add_first, set_fields

VALUES = {"gain": 800.0, "lookahead": 0.06, "lag": 0.071}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "# a lab\narm:\n  model: UR10e  # the new one\n",
        "arm: {model: UR10e}",
        "{arm: {model: UR10e}}",
        "servo:  # none measured yet\narm: {model: UR10e}\n",
        "servo: null  # none\n",
        "servo:\n  gain:   # to do\n  lag: 0.1",
        "servo:\n  poles:  # of the filter\n    - 1.0\n    - 2.0  # the slow one\n\n# the arm\narm: {model: UR10e}\n",
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
    set_fields(path, ("servo",), VALUES)
    after = path.read_text()
    assert yaml.safe_load(after) == {**before, "servo": {**(before.get("servo") or {}), **VALUES}}
    for comment in (line.partition("#")[2] for line in text.splitlines()):
        assert comment in after
    set_fields(path, ("servo",), VALUES)
    assert path.read_text() == after


@pytest.mark.parametrize(
    "text", ["servo: fast\n", "- servo\n", "arm: {model: UR10e}\n...\n", "servo: &a {gain: 1}\nother: *a\n"]
)
def test_a_layout_that_cannot_be_edited_is_left_alone(tmp_path: Path, text: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    with raises(ConfigError, code="config.not_editable"):
        set_fields(path, ("servo",), VALUES)
    assert path.read_text() == text


@given(st.dictionaries(st.sampled_from(["gain", "lag", "lookahead"]), st.floats(0, 1e4).map(lambda x: float(f"{x:g}"))))
def test_any_numbers_are_read_back(tmp_path_factory: pytest.TempPathFactory, values: dict[str, float]) -> None:
    path = tmp_path_factory.mktemp("edit") / "lab.yaml"
    path.write_text("servo:\n  gain: 300  # gentle\n")
    set_fields(path, ("servo",), values)
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
    set_fields(path, ("work",), {"xy": [0.75, -0.125]}, ("nails", "right"))
    after = path.read_text()
    assert yaml.safe_load(after) == {"work": {"nails": [left, {**right, "xy": [0.75, -0.125]}]}}
    for comment in (line.partition("#")[2] for line in text.splitlines()):
        assert comment in after


@pytest.mark.parametrize("text", ["", "work: {}\n", "work:\n  nails: []\n", "work:\n  nails:\n    - {name: left}\n"])
def test_a_record_that_is_not_there_is_not_added(tmp_path: Path, text: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    with raises(ConfigError, code="config.not_editable"):
        set_fields(path, ("work",), {"xy": [0.75, -0.125]}, ("nails", "right"))
    assert path.read_text() == text


LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"


def test_added_lines_are_the_only_change_and_stand_at_the_end_of_their_section(tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    before = (
        "# Ours\narm:\n    model: UR10e   # new\n    # host: 192.168.1.9, the old one\n\n"
        "# The hand\nhand: {model: mount,\n       port: x}  # tight\n"
    )
    path.write_text(before)
    set_fields(path, ("arm",), {"host": "192.168.1.10"})
    set_fields(path, ("camera", "device"), {"driver": "realsense", "serial": "832112070123"})
    set_fields(path, ("camera", "device"), {"least_range": 0.28})
    set_fields(path, ("camera",), {"fx": 383.0})
    lines = path.read_text().splitlines()
    host = lines.index('    host: "192.168.1.10"')
    assert lines[host - 1] == "    # host: 192.168.1.9, the old one"
    new = [
        "camera:",
        "  device:",
        "    driver: realsense",
        '    serial: "832112070123"',
        "    least_range: 0.28",
        "  fx: 383",
    ]
    assert [*lines[:host], *lines[host + 1 : -len(new)]] == before.splitlines()
    assert lines[-len(new) :] == new


@pytest.mark.parametrize(
    "value", ["on", "1:30", "2026-11-20", "007", "null", "a: b", "x # y", "é ✓ 𝛼", "", 1e-05, -2.5e-7, None]
)
def test_a_value_is_read_back_as_itself(tmp_path: Path, value: str | float | None) -> None:
    path = tmp_path / "lab.yaml"
    for text in ("", "a: {b: 1}\n", "a:\n  b: 1\n"):
        path.write_text(text)
        set_fields(path, ("a",), {"b": value, "c": value})
        assert yaml.safe_load(path.read_text()) == {"a": {"b": value, "c": value}}


@given(st.data())
def test_a_field_that_was_taken_out_of_an_example_is_set_again(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("edit") / "lab.yaml"
    lines = LAB.read_text().splitlines(keepends=True)
    said = yaml.safe_load(LAB.read_text())
    section = data.draw(st.sampled_from(["arm", "scene", "work", "person", "tool"]))
    fields = {n: v for n, v in said[section].items() if isinstance(v, int | float | str | list) and n != "obstacles"}
    name = data.draw(st.sampled_from(sorted(fields)))
    at = next(i for i, line in enumerate(lines) if line.startswith(f"  {name}:"))
    rest = [*lines[:at], *lines[at + 1 :]]
    path.write_text("".join(rest))
    set_fields(path, (section,), {name: fields[name]})
    after = path.read_text().splitlines(keepends=True)
    assert yaml.safe_load(path.read_text()) == said
    assert any([*after[:i], *after[i + 1 :]] == rest for i in range(len(after))), "one line more, no other one changed"


@pytest.mark.parametrize(
    ("text", "after"),
    [
        ("", "version: 2\n"),
        ("# a lab\n", "# a lab\nversion: 2\n"),
        ("# a lab\n\narm: {model: UR10e}  # new\n", "# a lab\n\nversion: 2\narm: {model: UR10e}  # new\n"),
        ("---\narm: {}", "---\nversion: 2\narm: {}"),
        ("{arm: {model: UR10e}}", "{version: 2, arm: {model: UR10e}}"),
        ("{}\n", "{version: 2}\n"),
        ("  arm: 1\n  # two\n  hand: 2\n", "  version: 2\n  arm: 1\n  # two\n  hand: 2\n"),
    ],
)
def test_a_field_is_added_before_all_others(tmp_path: Path, text: str, after: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    add_first(path, "version", 2)
    assert path.read_text() == after
    with raises(ConfigError, code="config.not_editable"):
        add_first(path, "version", 2)
    assert path.read_text() == after


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("- servo\n", "config.not_editable"),
        ("fast\n", "config.not_editable"),
        ("arm: 1\n...\n# the end\n---\n", "config.unreadable"),
    ],
)
def test_a_layout_that_has_no_first_field_is_left_alone(tmp_path: Path, text: str, code: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    with raises(ConfigError, code):
        add_first(path, "version", 2)
    assert path.read_text() == text


@pytest.mark.parametrize(
    ("text", "first", "gain"),
    [
        ("a: 1\r\n", "version: 2\r\na: 1\r\n", "a: 1\r\nservo:\r\n  gain: 3\r\n"),
        (
            "# x\r\nservo:\r\n  lag: 1\r\na: 1",
            "# x\r\nversion: 2\r\nservo:\r\n  lag: 1\r\na: 1",
            "# x\r\nservo:\r\n  lag: 1\r\n  gain: 3\r\na: 1",
        ),
        ("a: 1\r\nb: 2\n", "version: 2\na: 1\r\nb: 2\n", "a: 1\r\nb: 2\nservo:\n  gain: 3\n"),
    ],
)
def test_lines_end_as_the_files_do(tmp_path: Path, text: str, first: str, gain: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_bytes(text.encode())
    add_first(path, "version", 2)
    assert path.read_bytes() == first.encode()
    path.write_bytes(text.encode())
    set_fields(path, ("servo",), {"gain": 3})
    assert path.read_bytes() == gain.encode()


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664])
def test_a_link_and_the_files_permissions_stay(tmp_path: Path, mode: int) -> None:
    path, link = tmp_path / "station.yaml", tmp_path / "lab.yaml"
    path.write_text("a: 1\n")
    path.chmod(mode)
    link.symlink_to(path.name)
    set_fields(link, (), {"a": 2})
    assert link.is_symlink()
    assert path.read_text() == "a: 2\n"
    assert stat.S_IMODE(path.stat().st_mode) == mode
