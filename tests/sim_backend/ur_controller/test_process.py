"""The process of the controller stand-in: its address, and its end."""

from __future__ import annotations

import pytest

from tests.errors import raises
from toolee_robot.errors import DeviceError, UserError
from toolee_robot.sim_backend.ur_controller.controller import Controller, ControllerOptions
from toolee_robot.sim_backend.ur_controller.faults.client import FaultClient
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
