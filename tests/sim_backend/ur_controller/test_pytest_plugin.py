"""The page "Test your own UR program": its test runs as it stands, in a pytest of its own."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.sim
PAGE = Path(__file__).parents[3] / "docs/how-to/test_your_ur_program.md"


def test_the_pages_own_test_passes_and_each_controller_has_its_own_address(tmp_path: Path) -> None:
    conftest, its_test = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (tmp_path / "conftest.py").write_text(conftest)
    (tmp_path / "test_mine.py").write_text(its_test)
    (tmp_path / "test_two.py").write_text(
        "def test_two(ur10, ur10e, start_ur_controller):\n"
        "    third = start_ur_controller(model='UR10', profile='harsh')\n"
        "    assert len({ur10.host, ur10e.host, third.host}) == 3\n"
        "    assert third.state()['q'] == ur10.state()['q']\n"
    )
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "--rootdir",
        str(tmp_path),
        str(tmp_path),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert "2 passed" in done.stdout, done.stdout + done.stderr
