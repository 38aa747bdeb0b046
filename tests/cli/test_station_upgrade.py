"""`toolee station upgrade`: a file of version 2 keeps every word of a person; what was measured moves out of it."""

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

LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"
SERVO = next(line for line in LAB.read_text().splitlines(keepends=True) if line.startswith("servo:"))


def _version_2(servo: str = SERVO) -> str:
    return LAB.read_text().replace("version: 3", "version: 2").replace(SERVO, servo)


def _upgrade(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = run(["station", "upgrade", str(path)])
    captured = capsys.readouterr()
    return code, " ".join((captured.out + captured.err).split())


@pytest.mark.parametrize(
    "servo",
    [SERVO, "servo:\n  # as of May\n  gain: 1200\n  lookahead: 0.03\n\n  lag: 0.07  # s\n"],
    ids=["in one line", "in several"],
)
def test_what_programs_measured_moves_to_a_file_of_its_own(
    servo: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(_version_2(servo))
    code, told = _upgrade(path, capsys)
    assert code == 0
    assert "measured.yaml holds the measured values: servo.gain, servo.lookahead, servo.lag" in told
    assert path.read_text() == LAB.read_text().replace(SERVO, ""), "every other word stays"
    assert (tmp_path / "lab.yaml.v2").read_text() == _version_2(servo)
    assert yaml.safe_load((tmp_path / "measured.yaml").read_text())["servo"] == {
        "gain": 1200, "lookahead": 0.03, "lag": 0.07,
    }  # fmt: skip
    assert load_lab_station(path) == load_lab_station(LAB)
    after = path.read_bytes()
    code, told = _upgrade(path, capsys)
    assert code == 0
    assert "already has version 3: nothing was changed" in told
    assert path.read_bytes() == after


def test_what_cannot_be_told_from_the_rest_stays_and_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(_version_2("servo: {gain: 1200, lookahead: 0.03, lag: 0.07, watchdog: 8}\n"))
    _, told = _upgrade(path, capsys)
    assert "Delete them in" in told
    assert load_lab_station(path).servo.watchdog == 8
    assert load_lab_station(path).servo.lag == 0.07


def test_links_and_permissions_stay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "kept").mkdir()
    path, link = tmp_path / "kept" / "station.yaml", tmp_path / "lab.yaml"
    path.write_text(_version_2())
    path.chmod(0o600)
    link.symlink_to("kept/station.yaml")
    _upgrade(link, capsys)
    assert link.is_symlink()
    kept = path.with_name("station.yaml.v2")
    assert [stat.S_IMODE(file.stat().st_mode) for file in (path, kept)] == [0o600, 0o600]
    assert load_lab_station(link) == load_lab_station(LAB)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("version: 2\nwork: {nail_lenght: 0.03}\n", "did you mean nail_length?"),
        ("version: 1\n", "version 1 is unknown (line 1): this program reads version 3"),
        ("version: 4\n", "A newer file needs a newer toolee_robot"),
        ("[1, 2]\n", "names no version"),
    ],
)
def test_what_is_wrong_is_not_rewritten(
    text: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    code, told = _upgrade(path, capsys)
    assert code == 2
    assert words in told
    assert [file.name for file in tmp_path.iterdir()] == ["lab.yaml"]
    assert path.read_text() == text


def test_a_copy_that_is_there_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, kept = tmp_path / "lab.yaml", tmp_path / "lab.yaml.v2"
    path.write_text(_version_2())
    kept.write_text("of last year\n")
    code, told = _upgrade(path, capsys)
    assert code == 2
    assert "lab.yaml.v2 already exists: move it away" in told
    assert (path.read_text(), kept.read_text()) == (_version_2(), "of last year\n")


@pytest.mark.parametrize(
    "command",
    [
        ["run", "hammer"],
        ["rehearse", "hammer"],
        ["station", "check"],
        ["doctor", "--robot-host", "127.0.0.47", "--station"],
        ["arm", "transfer", "--to", "home", "--robot-host", "192.0.2.1", "--station"],
        ["calibrate", "camera", "--bars-mm", "360", "257", "--plate-distance", "0.1", "--plate-mass", "1", "--station"],
    ],
    ids=" ".join,
)
def test_what_opens_a_labs_devices_or_rehearses_names_the_upgrade(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(_version_2())
    assert run([*command, str(path)]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert f"is a station file of version 2 (line 3): run `toolee station upgrade {path}` once" in told


@pytest.mark.parametrize("version", ["4", "2a", "2.5", '"3"', "true", "0"])
@pytest.mark.parametrize("load", [load_station, load_lab_station])
def test_another_version_is_refused_everywhere(load: Any, version: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(LAB.read_text().replace("version: 3", f"version: {version}"))
    with raises(ConfigError, says="Upgrade version 1 with toolee_robot 0.1") as caught:
        load(path)
    assert f"version {yaml.safe_load(version)!r} is unknown (line 3): this program reads version 3" in str(caught.value)


def test_a_few_fields_for_the_simulation_need_no_version(tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text("task: {max_strikes: 7}\n")
    assert load_station(path).task.max_strikes == 7
    path.write_text("version: 3\n")
    assert load_station(path) == sim_station()
