"""The simulation's ground truth is out of reach of the task, the perception and the control."""

from __future__ import annotations

import ast
import dataclasses
import json
import os
import pickle
import re
import subprocess
import sys
from pathlib import Path

import pytest

import toolee_robot
from scripts import check_size
from toolee_robot import errors, hal

_ROOT = Path(toolee_robot.__file__).parent
_BLIND = ("tasks", "doctor", "perception", "control", "devices")
_IMPORT_ALL = """
import importlib, pkgutil, sys
for name in sys.argv[1:]:
    package = importlib.import_module("toolee_robot." + name)
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    bad = [m for m in sys.modules if m == "pybullet" or m.startswith("toolee_robot.sim_backend")]
    if bad:
        sys.exit(f"{name} loads {bad}")
"""
_OF_A_JOB = ("perception", "tasks", "stations", "control", "devices", "app")
_IMPORT_JOB = """
import importlib, pkgutil, sys
for name in sys.argv[1:]:
    package = importlib.import_module("toolee_robot." + name)
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        if module.name != "toolee_robot.perception.offline":
            importlib.import_module(module.name)
bad = [m for m in sys.modules if m.startswith("toolee_robot.perception.offline")]
if bad:
    sys.exit(f"a job loads {bad}")
"""


@pytest.mark.nightly
def test_importing_every_module_of_the_blind_packages_does_not_load_the_simulation() -> None:
    """In one process, which takes the time of importing what they share once."""
    done = subprocess.run(
        [sys.executable, "-c", _IMPORT_ALL, *_BLIND], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.nightly
def test_a_job_loads_nothing_that_trains_or_scores() -> None:
    """In a fresh process: what a trial compares with is loaded when it is asked for."""
    done = subprocess.run(
        [sys.executable, "-c", _IMPORT_JOB, *_OF_A_JOB], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


_OPEN_LAB = """
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from toolee_robot.errors import TooleeError
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import load_lab_station, load_station
from toolee_robot.stations.lab import LabStation
from toolee_robot.devices.hands import open_hand
from toolee_robot.stations.lab import ur_driver

config, clock = load_lab_station(Path(sys.argv[1])), HostClock()
with suppress(TooleeError), LabStation(config, print):  # its first device is not there
    sys.exit("a device answers")
for hand in sys.argv[2:]:
    with suppress(TooleeError), open_hand(load_station(Path(hand)).hand, clock):
        pass
arm = replace(config, arm=replace(config.arm, host="127.0.0.254"))
with suppress(TooleeError), ur_driver(arm, "127.0.0.254"):
    pass
bad = [m for m in sys.modules if m == "pybullet" or m.startswith("toolee_robot.sim_backend")]
if bad:
    sys.exit(f"a lab's station loads {bad}")
"""


@pytest.mark.nightly
def test_opening_a_labs_station_loads_no_module_of_the_simulation() -> None:
    """Each of its drivers is opened, up to the device that does not answer."""
    examples = _ROOT.parent / "examples"
    files = [examples / f"{name}.yaml" for name in ("lab", "mount", "inspire", "ability", "shadow")]
    done = subprocess.run(
        [sys.executable, "-c", _OPEN_LAB, *map(str, files)], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("package", _BLIND)
def test_no_blind_package_names_the_simulation_even_in_a_string(package: str) -> None:
    """Closes the way around the import rules: importlib, __import__, sys.modules with a name put together elsewhere."""
    for path in (_ROOT / package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names = [a.name for a in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or "", *(a.name for a in node.names)]
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and " " not in node.value:
                names = [node.value]
            else:
                continue
            # The servo process, which has nothing of the simulation in it, must keep the collector from pausing it.
            banned = {"pybullet", "inspect"} | (set() if path.name == "clock.py" else {"gc"})
            found = [n for n in names if "sim_backend" in n or n.split(".")[0] in banned]
            assert not found, f"{path}:{getattr(node, 'lineno', '?')} names {found}"


def test_the_hardware_abstraction_offers_these_and_no_truth() -> None:
    """Adding a member is a decision about what a real device can tell: it has to be made here too."""
    members = {
        name: {m for m in vars(protocol) if not m.startswith("_")}
        for name, protocol in vars(hal).items()
        if isinstance(protocol, type)
        and getattr(protocol, "_is_protocol", False)
        and protocol.__module__.startswith(f"{hal.__name__}.")
    }
    assert members == {
        "Device": set(),
        "Arm": {"rate", "state", "execute", "set_payload", "zero_wrench", "stop", "reset"},
        "HandGuidedArm": {"freedrive"},
        "Hand": {"joint_names", "state", "open", "close", "stop"},
        "KeepsCourse": {"course"},
        "ClearsFaults": {"clear_faults"},
        "RgbdCamera": {"intrinsics", "read"},
        "Person": {
            "request_handover",
            "release",
            "take_tool",
            "confirm_swing",
            "confirm_inspection",
            "hold_switch",
            "readings_certain",
            "zone_occupied",
            "hold_to_run_held",
        },
        "Clock": {"now", "sleep"},
    }
    assert {f.name for f in dataclasses.fields(hal.Station)} == {
        *("arm", "hand", "camera", "person", "clock"),
        *("robot_serial", "camera_serial"),
    }
    assert {f.name for f in dataclasses.fields(hal.HandState)} == {
        *("joints", "contact_forces", "holding", "assisted"),
        *("temperature", "fault"),
    }
    assert {f.name for f in dataclasses.fields(hal.ArmState)} == {
        *("joints", "q_commanded", "wrench", "status"),
        *("position_deviation_ratio", "collision_ratio", "digital_inputs"),
        *("safety_bits", "error_code"),
    }


NAMES = {
    "CameraIntrinsics", "Category", "HammeringTask", "RgbdFrame", "RunRecorder", "StationConfig", "ToolPerception",
    "TooleeError", "load_station", "nominal_grasp", "open_station", "sim_station",
}  # fmt: skip


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


@pytest.fixture
def house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    source = '# a comment\nX = 1\n"""What it is."""\n\n\ndef f() -> int:\n    """One."""\n    return X\n'
    for folder in (*check_size.PRODUCT, "control/arm", "tests"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "control" / "arm" / "code.py").write_text(source)
    (tmp_path / "toolee_robot" / "linked").symlink_to(tmp_path / "control")
    monkeypatch.setattr(check_size, "ROOT", tmp_path)
    monkeypatch.setattr(check_size, "BUDGET", tmp_path / "size_budget.toml")
    return tmp_path


@pytest.mark.parametrize(
    ("rooms", "code", "says"),
    [
        ('"control" = 3', 0, "size ok: 3 code lines in 1 files"),
        ('"control" = 2', 1, "control: 3 of 2, OVER"),
        ('"control" = 3\n"control/arm" = 2', 1, "control/arm: 3 of 2, OVER"),
        ('"toolee_robot" = 9', 1, "no room: 3 of 0, OVER"),
    ],
)
def test_a_room_over_its_budget_fails(
    house: Path, rooms: str, code: int, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (house / "size_budget.toml").write_text(f"[rooms]\n{rooms}\n[whole]\nproduct = 9\nfiles = 1\ntests = 0\n")
    assert check_size.main([]) == code
    assert says in capsys.readouterr().out
