"""`requirements-perception.txt` is what the perception alone needs, with the bounds of the package."""

from __future__ import annotations

import importlib.metadata
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.documents.blocks import ROOT

pytestmark = pytest.mark.sim(seconds=10)

NOT_LISTED = ("rtde_control", "rtde_receive", "rtde_io", "dashboard_client", "pinocchio", "coal", "ruckig")
"""Modules of dependencies whose distributions do not say which modules they have."""
_PERCEPTION_ONLY = """
import sys
banned = set(sys.argv[1:])
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in banned:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
import numpy as np
from toolee_robot import CameraIntrinsics, RgbdFrame, ToolPerception
from toolee_robot.cli.app import run
frame = RgbdFrame(np.zeros((424, 512, 3), np.uint8), np.full((424, 512), 0.7, np.float32),
                  CameraIntrinsics(365.5, 365.5, 254.9, 205.4, 512, 424))
print(len(ToolPerception.load().estimate(frame)), run(["estimate", "--bop", "/nonexistent"]))
generate = "dataset generate --config hard --size 1 --out nowhere"
for command in ("sim hammer --out nowhere", "doctor", "replay nowhere", generate):
    print(run(command.split()), file=sys.stderr)
"""


def _lines() -> list[str]:
    text = (ROOT / "requirements-perception.txt").read_text()
    return [line for line in text.splitlines() if line and not line.startswith("#")]


def _dependencies() -> list[str]:
    return list(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"])


def test_its_bounds_are_the_packages() -> None:
    assert set(_lines()) <= set(_dependencies())


def test_perception_runs_where_nothing_else_is_installed_and_other_commands_say_what_to_install(
    tmp_path: Path,
) -> None:
    others = {re.split(r"[<>=\[]", line)[0].lower().replace("_", "-") for line in set(_dependencies()) - set(_lines())}
    distributions = importlib.metadata.packages_distributions()
    banned = [
        module
        for module, names in distributions.items()
        if {name.lower().replace("_", "-") for name in names} <= others and not module.startswith("_")
    ]
    assert {"pybullet", "warp", "mcap"} <= set(banned)
    command = [sys.executable, "-c", _PERCEPTION_ONLY, *banned, *NOT_LISTED]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, cwd=tmp_path)
    numbers = [line for line in done.stdout.splitlines() if re.match(r"\d", line)]
    assert numbers == ["0 2"], done.stderr
    assert [line for line in done.stderr.splitlines() if line.isdigit()] == ["2"] * 4, done.stderr
    assert done.stderr.count("`python -m pip install -e .`") == 4, done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.glob("nowhere/*"))
