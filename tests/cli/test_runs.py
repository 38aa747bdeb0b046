"""`toolee runs` and what `toolee replay` does without a browser."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from tests.recording import small_run
from toolee_robot.cli.app import run
from toolee_robot.recording.reading import read_history


def _runs(folder: Path) -> None:
    done, killed = folder / "20261124-101500-seed7", folder / ".20261124-111500-seed8.partial"
    for path in (done, killed):
        path.mkdir(parents=True)
    small_run.write(done / "recording.mcap")
    whole = small_run.write(killed / "recording.mcap").read_bytes()
    (killed / "recording.mcap").write_bytes(whole[: len(whole) - 3000])
    summary = {"source": "simulation", "seed": 7, "outcome": "flush", "success": True, "strikes": 1}
    (done / "summary.json").write_text(json.dumps(summary | {"seconds": 9.0, "robot_seconds": 4.3}))
    (folder / "notes").mkdir()


def test_runs_are_listed_with_their_outcome(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _runs(tmp_path)
    assert run(["runs", str(tmp_path), "--json"]) == 0
    first, second = json.loads(capsys.readouterr().out)
    assert (first["outcome"], first["seed"], first["strikes"], first["date"]) == (
        "flush", 7, 1, "2026-11-24T10:15:00",
    )  # fmt: skip
    assert 0.3 < first["megabytes"] < 1.0
    assert (second["outcome"], second["success"]) == ("unfinished", None)
    assert run(["runs", str(tmp_path)]) == 0
    table = capsys.readouterr().out
    assert "20261124-101500-seed7" in table
    assert "unfinished" in table
    assert "notes" not in table


def test_a_folder_that_is_none_and_a_run_that_is_none_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["runs", str(tmp_path / "none")]) == 2
    assert run(["replay", str(tmp_path)]) == 2
    assert "recording.mcap" in capsys.readouterr().err


def test_a_killed_run_is_finished_into_a_file_that_every_reader_opens(tmp_path: Path) -> None:
    _runs(tmp_path)
    killed = tmp_path / ".20261124-111500-seed8.partial"
    assert not read_history(killed / "recording.mcap").complete
    assert run(["replay", str(killed), "--finish", str(tmp_path / "whole.mcap")]) == 0
    history = read_history(tmp_path / "whole.mcap")
    assert history.complete
    assert history.station().work.nail_protrusion == 0.02


@pytest.mark.sim(seconds=20)
def test_a_gif_of_ten_seconds_shows_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("toolee_robot.viewer.gif.RATE", 0.4)
    _runs(tmp_path)
    assert run(["replay", str(tmp_path / "20261124-101500-seed7"), "--gif", str(tmp_path / "run.gif")]) == 0
    with Image.open(tmp_path / "run.gif") as gif:
        pictures = [np.asarray(picture.convert("RGB")).astype(int) for picture in ImageSequence.Iterator(gif)]
        assert gif.info["duration"] * len(pictures) == 10_000
    assert abs(pictures[0] - pictures[-1]).mean() > 1.0, "the arm has moved"
    assert run(["replay", str(tmp_path / "20261124-101500-seed7"), "--gif", str(tmp_path / "no" / "such.gif")]) == 2


def test_damage_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("toolee_robot.viewer.gif.RATE", 0.2)
    _runs(tmp_path)
    path = tmp_path / "20261124-101500-seed7" / "recording.mcap"
    data = bytearray(path.read_bytes())
    data[data.index(b"tool.glb") + 5000] ^= 1
    path.write_bytes(data)
    assert run(["replay", str(path), "--gif", str(tmp_path / "run.gif")]) == 0
    assert "is damaged after" in capsys.readouterr().out
