"""The examples in Python under `scripts/` that no other test runs."""

from __future__ import annotations

import re

import pytest

from scripts import calibrate


@pytest.mark.nightly
@pytest.mark.sim(seconds=20)
def test_a_camera_is_calibrated_in_python(capsys: pytest.CaptureFixture[str]) -> None:
    calibrate.main(seed=1, poses=8)
    told = re.search(r"off by ([\d.]+) mm at ([\d.]+) m", capsys.readouterr().out)
    assert told is not None
    assert float(told[1]) < 2.0
    assert float(told[2]) > 0.5
