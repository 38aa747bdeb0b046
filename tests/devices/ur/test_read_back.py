"""What the driver sets is read back: a robot that reports another TCP or payload is refused, and stays latched."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tests.devices.ur.corrupting_proxy import CorruptingProxy, Rule
from tests.devices.ur.swings import swing
from tests.errors import raises
from tests.stand_in import HOME, SERVO, patient, stand_in
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.devices.ur.servo.client import ServoClient
from toolee_robot.errors import DeviceError, LatchedError, NotReadyError
from toolee_robot.hal import ArmStatus
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel, Payload

pytestmark = pytest.mark.realtime

ROBOT, HOST = "127.0.0.36", "127.0.0.37"
CONFIG = replace(patient(HOST), servo=replace(SERVO, handshake_timeout=1.0))
INSTALLED = Payload(1.0, np.zeros(3))
SET = Payload(2.5, np.array([0.01, 0.0, 0.1]))


@pytest.fixture(scope="module")
def controller() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10, ROBOT) as process:
        process.fault("payload", mass=INSTALLED.mass, cog=[0.0, 0.0, 0.0])
        yield process


@pytest.fixture(scope="module")
def proxy(controller: ControllerProcess) -> Iterator[CorruptingProxy]:
    with CorruptingProxy(HOST, controller.host) as network:
        yield network


def test_a_tcp_that_is_not_the_one_set_is_refused(controller: ControllerProcess, proxy: CorruptingProxy) -> None:
    proxy.arm(Rule("poison", b"tcp_offset", 0.1, every=True))
    try:
        with raises(DeviceError, code="device.tcp_mismatch"):
            ServoClient(CONFIG, 125.0)
    finally:
        proxy.heal()
    assert controller.state()["q"] == pytest.approx(HOME)


def test_after_a_reset_the_payload_is_the_installations_or_the_one_set_last_or_the_arm_stays_latched(
    controller: ControllerProcess, proxy: CorruptingProxy
) -> None:
    with UnsupervisedUrArm(replace(CONFIG, payload=INSTALLED), sim_station().arm) as arm:

        def fails() -> None:
            os.kill(arm.servo_pid, signal.SIGKILL)
            with pytest.raises(LatchedError):
                arm.execute(swing(HOME))

        fails()
        controller.fault("payload", mass=3.0, cog=[0.0, 0.0, 0.0])
        with raises(NotReadyError, code="not_ready.checks_failed"):
            arm.reset()
        controller.fault("payload", mass=INSTALLED.mass, cog=[0.0, 0.0, 0.0])
        arm.reset()
        arm.set_payload(SET)
        fails()
        controller.fault("payload", mass=3.0, cog=[0.0, 0.0, 0.0])
        proxy.arm(Rule("poison", b"payload", 9.0, every=True))
        with raises(DeviceError, code="device.payload_mismatch"):
            arm.reset()
        proxy.heal()
        with pytest.raises(LatchedError):
            arm.execute(swing(HOME))
        time.sleep(0.2)
        arm.reset()
        assert arm.state(1.0).status is ArmStatus.READY
        assert controller.state()["payload"] == pytest.approx(SET.mass)
