"""A robot that is not as configured keeps the driver from starting, and a row of one that is as configured fails."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.faults.rows.start import HAND, START_FAULTS, StartFault, start_row
from tests.rigs.setting import Setting
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.types import ArmModel

SETTING = Setting(ArmModel.UR10E, "127.0.0.68")


@pytest.fixture(scope="module")
def controller() -> Iterator[ControllerProcess]:
    with ControllerProcess(model=SETTING.model, host=SETTING.host) as controller:
        yield controller


@pytest.mark.sim
@pytest.mark.parametrize("name", ["wrong payload", "wrong TCP", "local control"])
def test_the_driver_refuses_to_start(controller: ControllerProcess, name: str) -> None:
    (fault,) = (f for f in START_FAULTS if f.fault == name)
    row = start_row(fault, SETTING, controller)
    assert row.handled, row.why
    assert row.off_path == 0.0


@pytest.mark.realtime
def test_a_robot_that_is_as_configured_is_no_handled_fault(controller: ControllerProcess) -> None:
    right = {"mass": HAND.mass, "cog": HAND.center_of_mass.tolist()}
    row = start_row(StartFault("none", "payload", right, "kg", "payload page"), SETTING, controller)
    assert not row.handled
    assert "the driver started" in row.why
    assert "a program was sent to the robot" in row.why
