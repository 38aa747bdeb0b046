"""Numbers as a person and as a machine read them, and files that are there whole or not at all."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.errors import UserError
from toolee_robot.frames import transform
from toolee_robot.runtime.files import json_line, run_folder, write_atomic
from toolee_robot.runtime.pose_text import pose_text, sigma_text


def test_json_is_one_strict_line_even_of_numpy_and_of_what_is_not_finite() -> None:
    line = json_line({"a": np.float64(1.5), "b": float("nan"), "c": [np.int64(2), np.inf], "d": {"e": "x\ny"}})
    assert "\n" not in line
    assert json.loads(line) == {"a": 1.5, "b": None, "c": [2, None], "d": {"e": "x\ny"}}


def test_a_pose_is_told_in_millimetres_and_degrees() -> None:
    text = pose_text(transform(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]), [0.1, -0.02, 0.0]))
    assert "+100.0, -20.0, +0.0) mm" in text
    assert "+90.0)°" in text


def test_a_free_spin_is_called_that_and_does_not_hide_the_tilt() -> None:
    covariance = np.diag([1e-6, 1e-6, 4e-6, np.deg2rad(1.5) ** 2, np.deg2rad(1.5) ** 2, np.pi**2 / 3])
    assert sigma_text(covariance, np.eye(4)) == "± 2.0 mm  axis ± 1.5°  spin free"
    covariance[5, 5] = np.deg2rad(4.0) ** 2
    assert sigma_text(covariance, np.eye(4)) == "± 2.0 mm  axis ± 1.5°  spin ± 4°"


def test_what_was_not_estimated_is_unknown() -> None:
    assert sigma_text(np.full((6, 6), np.nan), np.eye(4)) == pose_text(np.full((4, 4), np.nan)) == "unknown"


def test_a_file_that_cannot_be_written_leaves_nothing_and_says_so(tmp_path: Path) -> None:
    write_atomic(tmp_path / "a.txt", b"1")
    write_atomic(tmp_path / "a.txt", b"2")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.txt", b"2")]
    with raises(UserError, says="cannot write"):
        write_atomic(tmp_path / "none" / "a.txt", b"1")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")  # a device, such as /dev/full, would be replaced as well, by root
    for name in ("folder", "pipe"):
        with raises(UserError, says="cannot write"):
            write_atomic(tmp_path / name, b"1")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.txt", "folder", "pipe"]
    assert (tmp_path / "pipe").is_fifo()


def test_a_run_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    out = tmp_path / "runs"

    def break_off() -> None:
        with run_folder(out, "seed3") as folder:
            (folder.path / "recording.mcap").write_bytes(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        break_off()
    assert not out.exists(), "nothing of a run that broke stays, nor the folder made for it"

    with run_folder(out, "seed3") as folder:
        (folder.path / "summary.json").write_text("{}")
        assert not [p for p in out.iterdir() if not p.name.startswith(".")], "not there before it is whole"
        place = folder.keep()
    assert place.name.endswith("-seed3")
    assert [p.name for p in place.iterdir()] == ["summary.json"]
    assert list(out.iterdir()) == [place]
