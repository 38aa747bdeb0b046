"""The examples in Python under `scripts/` that no other test runs."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from scripts import calibrate, collect_photographs
from toolee_robot.perception.offline.evaluation.photographs import read_photographs


@pytest.mark.nightly
@pytest.mark.sim(seconds=20)
def test_a_camera_is_calibrated_in_python(capsys: pytest.CaptureFixture[str]) -> None:
    calibrate.main(seed=1, poses=8)
    told = re.search(r"off by ([\d.]+) mm at ([\d.]+) m", capsys.readouterr().out)
    assert told is not None
    assert float(told[1]) < 2.0
    assert float(told[2]) > 0.5


def test_photographs_are_paired_with_the_depth_nearest_in_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkout = tmp_path / "someone+office"
    for name in ("colour/1.00", "colour/1.10", "colour/2.00"):
        (checkout / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(checkout / f"{name}.png"), np.full((60, 80, 3), 128, np.uint8))
    for name, metres in (("depth/0.98", 0.5), ("depth/1.40", 0.7), ("depth/2.03", 0.9)):
        (checkout / name).parent.mkdir(exist_ok=True)
        depth = np.full((60, 80), round(5000 * metres), np.uint16)
        depth[10, 10], depth[20:26, 20:30] = 0, 60_000  # a gap of one pixel, and what is farther than is believed
        cv2.imwrite(str(checkout / f"{name}.png"), depth)
    for command in (["init", "-q"], ["add", "."], ["-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "a"]):
        subprocess.run(["git", *command], cwd=checkout, check=True)
    about: dict[str, Any] = {
        "place": "office",
        "repository": "someone/office",
        "commit": "HEAD",
        "depth_is": "measured",
    }
    about |= {"reader": "image_pairs", "paths": ["colour/*.png"], "depth": "depth/*.png", "named_by_time": True}
    about |= {"every": 2, "per_metre": 5000, "gaps": 3, "intrinsics": [70, 70, 40, 30]}
    (tmp_path / "sources.json").write_text(json.dumps({"sources": [about]}))
    monkeypatch.setattr(collect_photographs, "SOURCES", tmp_path / "sources.json")
    monkeypatch.setattr(sys, "argv", ["collect", str(tmp_path), "--out", str(tmp_path / "set")])
    collect_photographs.main()
    frames = read_photographs(tmp_path / "set")
    assert [(f.name, f.half) for f in frames] == [("office/001", "A"), ("office/002", "B")]
    assert [float(f.frame.depth.max()) for f in frames] == pytest.approx([0.5, 0.9])
    assert [f.frame.depth[10, 10] > 0 for f in frames] == [True, True]
    assert frames[0].frame.depth[23, 24] == 0
