"""Zeroing the force on the stand-in of both generations: what every reading and every contact guard sees afterwards."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tests.errors import raises
from tests.examples import timed
from tests.sim_backend.kinematics import line
from tests.stand_in import PATIENT, held, patient, stand_in
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import DeviceError, LatchedError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard, MotionOutcome
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel

pytestmark = pytest.mark.realtime

HOST = "127.0.0.35"
OFFSET = np.array([4.0, -5.0, 3.0, 0.3, 0.0, -0.2])  # [N, Nm] in the controller's base
MORE = np.array([10.0, 0.0, 0.0, 0.0, 0.0, 0.0])
NEAR = 1.0  # [N] for a stand-in that is noisy


@pytest.fixture(scope="module", params=[ArmModel.UR10, pytest.param(ArmModel.UR10E, marks=pytest.mark.nightly)])
def model(request: pytest.FixtureRequest) -> ArmModel:
    return ArmModel(request.param)


@pytest.fixture(scope="module")
def controller(model: ArmModel) -> Iterator[ControllerProcess]:
    with stand_in(model, HOST) as process:
        yield process


@pytest.fixture(scope="module")
def arm(controller: ControllerProcess, model: ArmModel) -> Iterator[UnsupervisedUrArm]:
    with UnsupervisedUrArm(patient(controller.host), replace(sim_station().arm, model=model)) as connected:
        yield connected


def feels(arm: UnsupervisedUrArm) -> Array:
    """(6,) [N, Nm] on average over 0.2 s."""
    wrenches = []
    for _ in range(20):
        time.sleep(0.01)
        wrenches.append(arm.state(1.0).wrench)
    return np.mean(wrenches, axis=0)


def push(controller: ControllerProcess, wrench: Array) -> None:
    controller.fault("force", wrench=wrench.tolist())
    time.sleep(0.1)


@pytest.mark.nightly
def test_a_zeroed_offset_is_in_no_reading_and_triggers_no_guard(
    arm: UnsupervisedUrArm, controller: ControllerProcess
) -> None:
    push(controller, OFFSET)
    assert np.linalg.norm(feels(arm)[:3]) > 5.0
    arm.zero_wrench()
    assert np.abs(feels(arm)).max() < NEAR
    q = held(arm)
    guard = ContactGuard(force=5.0, averaging_window=0.05)
    assert arm.execute(line([q, q + 0.02], 0.8), guard, PATIENT).outcome is MotionOutcome.COMPLETED
    push(controller, OFFSET + MORE)
    assert np.linalg.norm(feels(arm)[:3]) == pytest.approx(10.0, abs=NEAR)
    q = held(arm)
    assert arm.execute(line([q, q - 0.02], 0.8), guard, PATIENT).outcome is MotionOutcome.CONTACT


def test_what_the_arm_leans_against_is_not_zeroed(arm: UnsupervisedUrArm, controller: ControllerProcess) -> None:
    push(controller, np.zeros(6))
    arm.zero_wrench()
    push(controller, np.array([0.0, 0.0, 40.0, 0.0, 0.0, 0.0]))
    with raises(DeviceError, code="device.wrench_too_large"):
        arm.zero_wrench()
    assert np.linalg.norm(feels(arm)[:3]) == pytest.approx(40.0, abs=NEAR)
    push(controller, np.zeros(6))


@pytest.mark.nightly
def test_a_latched_arm_zeroes_nothing_and_after_the_reset_it_can(
    arm: UnsupervisedUrArm, controller: ControllerProcess
) -> None:
    controller.fault("protective_stop")
    time.sleep(0.3)
    with raises(LatchedError, code="latched"):
        arm.zero_wrench()
    controller.fault("unlock")
    time.sleep(0.2)
    arm.reset()
    push(controller, OFFSET)
    arm.zero_wrench()
    assert np.abs(feels(arm)).max() < NEAR
    push(controller, np.zeros(6))


@timed
def test_while_it_is_zeroed_others_see_fresh_states_and_no_second_call_gets_in(
    arm: UnsupervisedUrArm, timed: bool
) -> None:
    zeroing = threading.Thread(target=arm.zero_wrench)
    zeroing.start()
    time.sleep(0.2)
    assert arm.state(0.15 if timed else 5.0).joints.stamp > 0.0
    with raises(DeviceError, code="device.busy"):
        arm.zero_wrench()
    zeroing.join()
