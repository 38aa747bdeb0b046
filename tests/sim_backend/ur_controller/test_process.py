"""The process of the controller stand-in: its address, and its end."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.errors import raises
from toolee_robot.errors import DeviceError, UserError
from toolee_robot.sim_backend.ur_controller.controller import Controller, ControllerOptions
from toolee_robot.sim_backend.ur_controller.faults.fault_port import FaultClient
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess, resting_joints

pytestmark = pytest.mark.sim


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.10", "robot"])
def test_only_loopback_is_served(host: str) -> None:
    with raises(UserError, code="user.not_loopback"):
        Controller(ControllerOptions(host=host), resting_joints)


def test_clients_are_closed_before_the_controller() -> None:
    order: list[str] = []
    with ControllerProcess(host="127.0.0.17") as controller:
        controller.on_exit(lambda: order.append(controller.state()["model"]))
    assert order == ["UR10"]
    with pytest.raises(DeviceError, match="toolee emulate ur --host"):
        FaultClient("127.0.0.17", timeout=1.0)


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
