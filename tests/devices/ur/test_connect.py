"""Connecting, freedrive and payload: typed errors in bounded time, and what the controller stand-in says of it."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest

from tests.errors import raises
from tests.sim_backend.kinematics import line
from tests.stand_in import PATIENT, held, patient, stand_in
from toolee_robot.control.motion.trajectory_checks import START_TOLERANCE
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.devices.ur.servo.client import ServoClient
from toolee_robot.errors import DeviceError, NotReadyError, ServoCrashError
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import ServoConfig, sim_station
from toolee_robot.types import ArmModel, Payload

HOST, NOBODY, SILENT = "127.0.0.25", "127.0.0.26", "127.0.0.27"
PORTS = (29999, 30001, 30002, 30003, 30004)


@pytest.fixture(scope="module")
def controller() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10E, HOST) as process:
        yield process


def test_where_no_robot_is_the_arm_is_not_ready() -> None:
    with pytest.raises(NotReadyError, match=NOBODY), UnsupervisedUrArm(UrArmConfig(NOBODY), sim_station().arm):
        pass


@pytest.mark.sim
def test_a_robot_that_is_silent_ends_the_servo_process_in_time() -> None:
    with ExitStack() as stack:
        for port in PORTS:
            server = stack.enter_context(socket.socket())
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            server.bind((SILENT, port))
            server.listen()
        began = time.monotonic()
        # ur_rtde's constructor waits for an answer, holds the interpreter's lock, and cannot be told to stop.
        with pytest.raises(ServoCrashError, match="in time"):
            ServoClient(UrArmConfig(SILENT, ServoConfig(connect_timeout=1.0)), 125.0)
        assert time.monotonic() - began < 1.0 + 8.0  # starting a process on a busy machine


@pytest.mark.sim
def test_another_model_than_configured_is_refused(controller: ControllerProcess) -> None:
    with pytest.raises(NotReadyError, match="UR10"), UnsupervisedUrArm(patient(controller.host), sim_station().arm):
        pass


@pytest.mark.sim
def test_a_robot_in_protective_stop_is_refused(controller: ControllerProcess) -> None:
    controller.fault("protective_stop")
    with (
        pytest.raises(NotReadyError, match="protective"),
        UnsupervisedUrArm(patient(controller.host), replace(sim_station().arm, model=ArmModel.UR10E)),
    ):
        pass
    controller.fault("reset")


@pytest.mark.realtime
def test_payload_and_freedrive_reach_the_robot_and_nobody_else_does(controller: ControllerProcess) -> None:
    limits = replace(sim_station().arm, model=ArmModel.UR10E)
    with UnsupervisedUrArm(patient(controller.host), limits) as arm:
        arm.set_payload(Payload(2.5, np.array([0.01, -0.02, 0.09])))
        state = controller.state()
        assert state["payload"] == pytest.approx(2.5)
        assert state["payload_cog"] == pytest.approx([0.01, -0.02, 0.09])
        assert state["tcp"] == pytest.approx([0.0] * 6)
        # A second driver is refused, and the first does not notice.
        with raises(DeviceError, code="device.connection_refused"):
            ServoClient(patient(controller.host), 500.0)
        q = held(arm)
        with arm.freedrive():
            with raises(DeviceError, code="device.busy"):
                arm.execute(line([q, q + 0.05], 0.5))
            time.sleep(0.5)  # the watchdog is fed
            assert controller.state()["program_state"] == "PLAYING"
        arm.execute(line([held(arm), held(arm) + 0.05], 0.5), None, PATIENT)
        np.testing.assert_allclose(controller.state()["q"], q + 0.05, atol=1e-6)
        # Let go of in mid-motion it brakes first, and what comes next starts where it then stands.
        q = held(arm)
        controller.fault("force", wrench=[0.0, 40.0, 0.0, 0.0, 0.0, 0.0], seconds=0.8)
        with arm.freedrive():
            time.sleep(0.5)
        there = held(arm)
        assert np.abs(there - q).max() > 0.02
        time.sleep(0.2)
        np.testing.assert_allclose(controller.state()["q"], there, atol=START_TOLERANCE)
        arm.execute(line([there, there + 0.05], 0.5), None, PATIENT)
        np.testing.assert_allclose(controller.state()["q"], there + 0.05, atol=1e-6)
    assert controller.state()["program_state"] == "STOPPED"
