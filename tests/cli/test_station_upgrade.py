"""`toolee station upgrade`: a file of version 1 is rewritten once, keeps every word, and what it lacks is named."""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.errors import raises
from toolee_robot.cli.app import run
from toolee_robot.errors import ConfigError
from toolee_robot.station import load_lab_station, load_station, sim_station

EXAMPLES = Path(__file__).parents[2] / "examples"
LAB = EXAMPLES / "lab.yaml"
FRAGMENTS = ("ability", "inspire", "long_nail", "mount", "nails", "shadow", "thick_block")
NEW = ("version: 2\n", "  up: [0.0, 0.0, 1.0]               # the base stands upright\n")
"""Lines of the examples that version 1 did not have."""
SHORT = """\
# Our lab, measured in May.

# Read at the pendant.
frame: pendant_base
arm:
  model: UR10e   # from the name plate
work: {nail_xy: [-0.75, -0.10]}
"""


def _version_1(example: str) -> str:
    lines = (EXAMPLES / f"{example}.yaml").read_text().splitlines(keepends=True)
    return "".join(line for line in lines if line not in NEW)


def _upgrade(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = run(["station", "upgrade", str(path)])
    captured = capsys.readouterr()
    return code, " ".join((captured.out + captured.err).split())


@pytest.mark.parametrize("example", FRAGMENTS)
def test_an_example_as_it_was_becomes_the_one_that_is_there(
    example: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, before = tmp_path / f"{example}.yaml", _version_1(example)
    path.write_text(before)
    as_it_was = load_station(path)
    code, told = _upgrade(path, capsys)
    assert code == 1, "a fragment is no whole lab"
    assert path.read_text() == (EXAMPLES / f"{example}.yaml").read_text()
    assert (tmp_path / f"{example}.yaml.v1").read_text() == before
    assert load_station(path) == as_it_was
    assert "arm: model, host" in told


def test_a_whole_labs_file_lacks_the_mounting_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(_version_1("lab"))
    code, told = _upgrade(path, capsys)
    assert code == 1
    assert "is of version 2 now. Changed: version: 2 (line 3)" in told
    wanted = told[told.index("Version 2 wants") : told.index("Next:")]
    assert wanted.split("say ")[1].startswith("arm: up (`arm` begins in line 5) from: spirit level on the base")
    assert wanted.count("from:") == 1
    with raises(ConfigError, "config.unmeasured") as caught:
        load_lab_station(path)
    assert "measure and give arm.up (`arm` begins in line 5)" in str(caught.value)
    assert "up:" not in path.read_text(), "no value is invented"
    path.write_text(path.read_text().replace("  model: UR10\n", "  model: UR10\n  up: [0.0, 0.0, 1.0]\n"))
    assert load_lab_station(path) == load_lab_station(LAB)


def test_a_file_of_version_2_stays_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(SHORT)
    path.chmod(0o640)
    _upgrade(path, capsys)
    assert path.read_text() == SHORT.replace("frame:", "version: 2\nframe:")
    after = path.read_bytes()
    code, told = _upgrade(path, capsys)
    assert code == 0
    assert "is of version 2 already: nothing was changed" in told
    assert path.read_bytes() == after
    assert sorted(p.name for p in tmp_path.iterdir()) == ["lab.yaml", "lab.yaml.v1"]
    assert stat.S_IMODE((tmp_path / "lab.yaml.v1").stat().st_mode) & 0o400


def test_a_version_1_that_is_written_down_is_replaced_in_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(f"{SHORT}version: 1  # of May\n")
    code, told = _upgrade(path, capsys)
    assert code == 1
    assert "Changed: version: 2 (line 8)" in told
    assert path.read_text() == f"{SHORT}version: 2  # of May\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("work: {nail_lenght: 0.03}\n", "did you mean nail_length?"),
        ("version: 3\n", "version 3 is unknown (line 1): this program reads version 2"),
        ("[1, 2]\n", "fields with their values are needed"),
        ("&lab\nframe: base_link\n", "enter it by hand: version: 2"),
    ],
)
def test_what_is_wrong_or_not_editable_is_not_rewritten(
    text: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    code, told = _upgrade(path, capsys)
    assert code == 2
    assert words in told
    assert path.read_text() == text
    assert not (tmp_path / "lab.yaml.v1").exists()


@pytest.mark.parametrize("extra", ["", "version: 1\n"])
def test_links_permissions_and_line_ends_stay(extra: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "kept").mkdir()
    path, link = tmp_path / "kept" / "station.yaml", tmp_path / "lab.yaml"
    before = f"{SHORT}{extra}".replace("\n", "\r\n").encode()
    path.write_bytes(before)
    path.chmod(0o600)
    link.symlink_to("kept/station.yaml")
    code, told = _upgrade(link, capsys)
    assert code == 1
    assert link.is_symlink()
    text = f"{SHORT}version: 2\n" if extra else SHORT.replace("frame:", "version: 2\nframe:")
    assert path.read_bytes() == text.replace("\n", "\r\n").encode()
    copy = path.with_name("station.yaml.v1")
    assert str(copy) in told
    assert copy.read_bytes() == before
    assert [stat.S_IMODE(file.stat().st_mode) for file in (path, copy)] == [0o600, 0o600]
    assert sorted(file.name for file in tmp_path.rglob("*")) == ["kept", "lab.yaml", "station.yaml", "station.yaml.v1"]


def test_a_copy_that_is_there_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, kept = tmp_path / "lab.yaml", tmp_path / "lab.yaml.v1"
    path.write_text(SHORT)
    kept.write_text("of last year\n")
    code, told = _upgrade(path, capsys)
    assert code == 2
    assert "lab.yaml.v1 is there already: move it away" in told
    assert (path.read_text(), kept.read_text()) == (SHORT, "of last year\n")


@pytest.mark.parametrize(
    "command",
    [
        ["run", "hammer"],
        ["rehearse", "hammer"],
        ["station", "check"],
        ["station", "new"],
        ["doctor", "--robot-host", "127.0.0.47", "--config"],
        ["arm", "transfer", "--to", "home", "--robot-host", "192.0.2.1", "--config"],
        ["calibrate", "camera", "--bars-mm", "360", "257", "--plate-distance", "0.1", "--plate-mass", "1", "--station"],
    ],
    ids=" ".join,
)
def test_what_opens_a_labs_devices_or_rehearses_names_the_upgrade(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(_version_1("lab"))
    assert run([*command, str(path)]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert f"is a station file of version 1: run `toolee station upgrade {path}`" in told


@pytest.mark.parametrize("version", ["3", "2a", "2.0", '"2"', "true", "0", "null"])
@pytest.mark.parametrize("load", [load_station, load_lab_station])
def test_another_version_is_refused_everywhere(load: Any, version: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(LAB.read_text().replace("version: 2", f"version: {version}"))
    with raises(ConfigError, "config.version_unknown") as caught:
        load(path)
    assert f"version {yaml.safe_load(version)!r} is unknown (line 3): this program reads version 2" in str(caught.value)


def test_a_few_fields_for_the_simulation_need_no_version(tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text("task: {max_strikes: 7}\n")
    assert load_station(path).task.max_strikes == 7
    path.write_text("version: 2\n")
    assert load_station(path) == sim_station()
