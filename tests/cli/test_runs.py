"""What `toolee replay` does without a browser."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from tests.recording import small_run
from toolee_robot.cli.app import run


def _run_in(folder: Path) -> None:
    done = folder / "20261124-101500-seed7"
    done.mkdir(parents=True)
    small_run.write(done / "recording.mcap")


def test_a_folder_that_is_no_runs_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["replay", str(tmp_path)]) == 2
    assert "recording.mcap" in capsys.readouterr().err


@pytest.mark.sim(seconds=20)
def test_a_gif_of_ten_seconds_shows_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("toolee_robot.viewer.gif.RATE", 0.4)
    _run_in(tmp_path)
    assert run(["replay", str(tmp_path / "20261124-101500-seed7"), "--gif", str(tmp_path / "run.gif")]) == 0
    with Image.open(tmp_path / "run.gif") as gif:
        pictures = [np.asarray(picture.convert("RGB")).astype(int) for picture in ImageSequence.Iterator(gif)]
        assert gif.info["duration"] * len(pictures) == 10_000
    assert abs(pictures[0] - pictures[-1]).mean() > 1.0, "the arm has moved"
    assert run(["replay", str(tmp_path / "20261124-101500-seed7"), "--gif", str(tmp_path / "no" / "such.gif")]) == 2


def test_damage_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("toolee_robot.viewer.gif.RATE", 0.2)
    _run_in(tmp_path)
    path = tmp_path / "20261124-101500-seed7" / "recording.mcap"
    data = bytearray(path.read_bytes())
    data[data.index(b"tool.glb") + 5000] ^= 1
    path.write_bytes(data)
    assert run(["replay", str(path), "--gif", str(tmp_path / "run.gif")]) == 0
    assert "is damaged before byte" in capsys.readouterr().out
