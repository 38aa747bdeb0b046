"""What a program builds on: the package's names, and what importing them costs."""

from __future__ import annotations

import json
import os
import pickle
import re
import subprocess
import sys

import pytest

import toolee_robot
from toolee_robot import errors

NAMES = {
    "CameraIntrinsics", "Category", "HammeringTask", "RgbdFrame", "RunRecorder", "StationConfig", "ToolPerception",
    "TooleeError", "load_station", "nominal_grasp", "open_station", "sim_station",
}  # fmt: skip
HEAVY = [
    "pybullet",
    "rtde_control",
    "rtde_receive",
    "rtde_io",
    "warp",
    "mujoco",
    "ray",
    "embreex",
    "manifold3d",
    "foxglove",
    "mcap",
]


def test_the_public_names_are_these() -> None:
    """A snapshot: to change it is to change what programs are built on, and belongs in the changelog."""
    assert set(toolee_robot.__all__) == NAMES
    for name in NAMES:
        assert getattr(toolee_robot, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'SimStation'"):
        _ = toolee_robot.SimStation


def python(code: str, *args: str) -> str:
    clean = {name: value for name, value in os.environ.items() if name not in ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")}
    done = subprocess.run(
        [sys.executable, "-c", code, *args], capture_output=True, text=True, check=True, timeout=120, env=clean
    )
    return done.stdout


def test_importing_the_package_changes_no_environment_variable_and_loads_next_to_nothing() -> None:
    code = """
import json, os, sys
before = dict(os.environ)
import toolee_robot
from toolee_robot import CameraIntrinsics
print(json.dumps([dict(os.environ) == before, sorted(m for m in sys.modules if m in ("torch", "pybullet", "warp"))]))
"""
    assert json.loads(python(code)) == [True, []]


def test_perception_and_the_command_line_load_without_simulation_and_robot_driver() -> None:
    """What `toolee estimate` needs is what the perception alone needs: none of these can be imported here."""
    code = """
import sys
banned = sys.argv[1:]
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in banned:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
from toolee_robot import ToolPerception
from toolee_robot.cli.app import run
import toolee_robot.perception.io
print(run(["estimate", "--bop", "/nonexistent/000001"]))
"""
    assert python(code, *HEAVY).splitlines()[-1] == "2"


def _all_errors(root: type[errors.TooleeError] = errors.TooleeError) -> set[type[errors.TooleeError]]:
    return {root}.union(*(_all_errors(kind) for kind in root.__subclasses__()))


def test_every_error_has_a_code_of_its_own() -> None:
    kinds = [kind for kind in _all_errors() if kind.__module__ == errors.__name__]
    codes = [kind.code for kind in kinds]
    assert len(set(codes)) == len(codes)
    assert all(re.fullmatch(r"[a-z]+(_[a-z]+)*", code) for code in codes)


def test_a_code_survives_the_way_between_processes() -> None:
    specific = errors.LinkLostError("cut", None, code="link_lost.cable")
    for error in (specific, errors.UserError("bad")):
        other = pickle.loads(pickle.dumps(error))
        assert (other.code, str(other)) == (error.code, str(error))
