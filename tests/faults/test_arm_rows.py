"""Rows of the arm's part on a harsh controller are handled, and a row whose reaction fails to come is not."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from tests.faults.record import Measurement, Phase
from tests.faults.rows.arm import ARM_FAULTS, arm_rows, slider_at_rest
from tests.faults.rows.collisions import (
    COLLISIONS,
    RESTRICTED,
    UNREACHABLE,
    collision_rows,
    restricted_rows,
)
from tests.faults.rows.inputs import SWITCH_FAULTS, input_rows, switch_rows
from tests.faults.rows.process import following_rows, process_rows
from tests.faults.rows.released_stops import RELEASED_STOPS, released_row, released_rows
from tests.faults.rows.start import HAND, START_FAULTS, StartFault, start_row
from tests.rigs.driver_rig import Rig, rig
from tests.rigs.setting import Setting
from toolee_robot.runtime.latency_monitor import LatencyMonitor
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.robot import error_codes
from toolee_robot.types import ArmModel

HARSH = Setting(ArmModel.UR10E, "127.0.0.64", "harsh")
OWN = replace(HARSH, host="127.0.0.65")
"""For rows with a stand-in of their own."""


@pytest.fixture(scope="module")
def machine() -> Iterator[LatencyMonitor]:
    with LatencyMonitor() as monitor:
        yield monitor


@pytest.fixture(scope="module")
def arm_rig() -> Iterator[Rig]:
    with rig(HARSH) as arm_rig:
        yield arm_rig


@contextmanager
def ctrl_c_ignored() -> Iterator[None]:
    """As in whatever a shell starts in the background."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def check(measurement: Measurement, machine: LatencyMonitor) -> None:
    row = measurement.row(machine)
    assert row.handled, row.why


@pytest.mark.realtime
def test_every_detection_has_a_row() -> None:
    codes = {fault.code for fault in (*COLLISIONS, *RESTRICTED)}
    kinds = {"C153", "C157", "C158", "C159", "C173", "C174", f"C{error_codes.PATH_SANITY}A{error_codes.SUDDEN_STOP}"}
    arguments = (
        error_codes.JOINT_POSITION, error_codes.JOINT_SPEED, error_codes.TCP_SPEED, error_codes.POWER,
        error_codes.TORQUE_WINDOW, error_codes.MOMENTUM,
    )  # fmt: skip
    assert codes | set(UNREACHABLE) == kinds | {f"C{error_codes.SAFETY_VIOLATION}A{argument}" for argument in arguments}
    # tests/sim_backend/ur_controller/ur_rtde/test_harsh_script.py: no stream that this script ends is a sudden stop.
    assert set(UNREACHABLE) == {"C204A3"}
    assert not codes & set(UNREACHABLE)


@pytest.mark.realtime
@pytest.mark.parametrize("name", ["connection closed (FIN)", "servo loop late by 60 ms"])
def test_a_fault_in_mid_swing_is_told_and_latches(name: str, arm_rig: Rig, machine: LatencyMonitor) -> None:
    for measurement in arm_rows(arm_rig, timed=False):
        if measurement.fault == name and measurement.phase is Phase.SWING:
            check(measurement, machine)


@pytest.mark.nightly
@pytest.mark.realtime
@pytest.mark.parametrize("name", [fault.fault for fault in ARM_FAULTS])
def test_a_fault_of_the_arm_is_handled(name: str, arm_rig: Rig, machine: LatencyMonitor) -> None:
    for measurement in arm_rows(arm_rig):
        if measurement.fault == name:
            check(measurement, machine)


@pytest.mark.nightly
@pytest.mark.realtime
def test_release_and_play_move_nothing(arm_rig: Rig, machine: LatencyMonitor) -> None:
    first = next(iter(released_rows(arm_rig)))
    check(first, machine)


@pytest.mark.realtime
@pytest.mark.nightly
@pytest.mark.parametrize("rows", [released_rows, following_rows, collision_rows, input_rows, switch_rows])
def test_rows_on_one_stand_in(rows: object, arm_rig: Rig, machine: LatencyMonitor) -> None:
    for measurement in rows(arm_rig):  # type: ignore[operator]
        check(measurement, machine)


@pytest.mark.realtime
@pytest.mark.nightly
def test_a_restricted_safety_configuration(machine: LatencyMonitor) -> None:
    for measurement in restricted_rows(OWN):
        check(measurement, machine)


@pytest.mark.realtime
@pytest.mark.nightly
def test_ctrl_c_reaches_a_task_whose_parent_ignores_it(machine: LatencyMonitor) -> None:
    with ctrl_c_ignored():
        check(next(iter(process_rows(OWN))), machine)


@pytest.mark.realtime
def test_the_matrix_has_the_switch_in_each_phase(arm_rig: Rig) -> None:
    rows = [(row.fault, row.phase) for row in switch_rows(arm_rig)]
    assert len(set(rows)) == len(rows)
    for fault in SWITCH_FAULTS:
        assert {phase for name, phase in rows if name == fault.fault} >= {Phase.REST, Phase.SWING}


@pytest.mark.nightly
@pytest.mark.realtime
def test_a_slider_that_is_moved_at_rest_latches_nothing(arm_rig: Rig) -> None:
    row = slider_at_rest(arm_rig)
    assert row.handled, row.why
    assert not row.latched


# -- the matrix can fail -------------------------------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.realtime
def test_a_stop_that_does_not_come_is_not_handled(arm_rig: Rig) -> None:
    row = released_row(replace(RELEASED_STOPS[0], stop=lambda _: None), Phase.REST, arm_rig)
    assert not row.handled
    assert "the next motion was not refused" in row.why
    assert "program is PLAYING" in row.why


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


@pytest.mark.nightly
@pytest.mark.realtime
def test_a_robot_that_is_as_configured_is_no_handled_fault(controller: ControllerProcess) -> None:
    right = {"mass": HAND.mass, "cog": HAND.center_of_mass.tolist()}
    row = start_row(StartFault("none", "payload", right, "kg", "payload page"), SETTING, controller)
    assert not row.handled
    assert "the driver started" in row.why
    assert "a program was sent to the robot" in row.why
