"""Connecting, freedrive and payload: typed errors in bounded time, and what the controller stand-in says of it."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest

from tests.devices.ur.corrupting_proxy import CorruptingProxy, Rule
from tests.devices.ur.swings import swing
from tests.errors import raises
from tests.rigs.people import People
from tests.sim_backend.kinematics import line
from tests.stand_in import HOME, PATIENT, SERVO, held, patient, stand_in
from toolee_robot.control import RobotModel
from toolee_robot.control.motion.trajectory_checks import START_TOLERANCE
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.devices.ur.servo.client import ServoClient
from toolee_robot.errors import DeviceError, LatchedError, LimitError, NotReadyError, PersonNearError, ServoCrashError
from toolee_robot.hal import Arm, ArmStatus, MotionOutcome
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import ServoConfig, sim_station
from toolee_robot.stations.lab import open_arm
from toolee_robot.types import ArmModel, Payload

HOST, NOBODY, SILENT = "127.0.0.25", "127.0.0.26", "127.0.0.27"
PORTS = (29999, 30001, 30002, 30003, 30004)


@pytest.fixture(scope="module")
def controller() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10E, HOST) as process:
        yield process


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


@pytest.mark.nightly
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


HOST_OPEN_ARM = "127.0.0.34"
CONFIG = sim_station()
CONFIG = replace(CONFIG, supervisor=replace(CONFIG.supervisor, data_cycles=50.0, overruns=50))  # a busy machine


@pytest.fixture(scope="module")
def controller_of_open_arm() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10, HOST_OPEN_ARM) as process:
        hand = RobotModel.of_station(CONFIG).description
        payload = hand.hand_payload(hand.hand_open)
        process.fault("payload", mass=payload.mass, cog=payload.center_of_mass.tolist())
        yield process


@pytest.mark.realtime
def test_the_arm_of_a_station_file_moves_slowly_and_by_hand_with_a_person_who_lets_it(
    controller_of_open_arm: ControllerProcess,
) -> None:
    people = People()
    with open_arm(CONFIG, HOST_OPEN_ARM, people) as arm:
        assert isinstance(arm, Arm)
        q = arm.state().q_commanded
        with raises(LimitError, code="limit.speed"):
            arm.execute(line([q, q + 0.1], 0.3))
        people.holds_switch = False
        with raises(PersonNearError, code="person_near.before_motion"):
            arm.execute(line([q, q + 0.02], 1.5))
        with raises(PersonNearError, code="person_near.freedrive"), arm.freedrive():
            pass
        people.holds_switch = True
        assert people.hold_switch("", 1.0)
        assert arm.execute(line([q, q + 0.02], 1.5)).outcome is MotionOutcome.COMPLETED
        with arm.freedrive():
            pass
    np.testing.assert_allclose(controller_of_open_arm.state()["q"], HOME + 0.02, atol=1e-3)


@pytest.mark.realtime
def test_a_robot_with_another_payload_is_refused(controller_of_open_arm: ControllerProcess) -> None:
    controller_of_open_arm.fault("payload", mass=1.0, cog=[0.0, 0.0, 0.0])
    with raises(NotReadyError, code="not_ready.checks_failed") as refused, open_arm(CONFIG, HOST_OPEN_ARM, People()):
        pass
    assert "payload" in str(refused.value)


ROBOT, HOST_READ_BACK = "127.0.0.36", "127.0.0.37"
CONFIG_READ_BACK = replace(patient(HOST_READ_BACK), servo=replace(SERVO, handshake_timeout=1.0))
INSTALLED = Payload(1.0, np.zeros(3))
SET = Payload(2.5, np.array([0.01, 0.0, 0.1]))


@pytest.fixture(scope="module")
def controller_of_read_back() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10, ROBOT) as process:
        process.fault("payload", mass=INSTALLED.mass, cog=[0.0, 0.0, 0.0])
        yield process


@pytest.fixture(scope="module")
def proxy(controller_of_read_back: ControllerProcess) -> Iterator[CorruptingProxy]:
    with CorruptingProxy(HOST_READ_BACK, controller_of_read_back.host) as network:
        yield network


@pytest.mark.nightly
@pytest.mark.realtime
def test_a_tcp_that_is_not_the_one_set_is_refused(
    controller_of_read_back: ControllerProcess, proxy: CorruptingProxy
) -> None:
    proxy.arm(Rule("poison", b"tcp_offset", 0.1, every=True))
    try:
        with raises(DeviceError, code="device.tcp_mismatch"):
            ServoClient(CONFIG_READ_BACK, 125.0)
    finally:
        proxy.heal()
    assert controller_of_read_back.state()["q"] == pytest.approx(HOME)


@pytest.mark.nightly
@pytest.mark.realtime
def test_after_a_reset_the_payload_is_the_installations_or_the_one_set_last_or_the_arm_stays_latched(
    controller_of_read_back: ControllerProcess, proxy: CorruptingProxy
) -> None:
    with UnsupervisedUrArm(replace(CONFIG_READ_BACK, payload=INSTALLED), sim_station().arm) as arm:

        def fails() -> None:
            os.kill(arm.servo_pid, signal.SIGKILL)
            with pytest.raises(LatchedError):
                arm.execute(swing(HOME))

        fails()
        controller_of_read_back.fault("payload", mass=3.0, cog=[0.0, 0.0, 0.0])
        with raises(NotReadyError, code="not_ready.checks_failed"):
            arm.reset()
        controller_of_read_back.fault("payload", mass=INSTALLED.mass, cog=[0.0, 0.0, 0.0])
        arm.reset()
        arm.set_payload(SET)
        fails()
        controller_of_read_back.fault("payload", mass=3.0, cog=[0.0, 0.0, 0.0])
        proxy.arm(Rule("poison", b"payload", 9.0, every=True))
        with raises(DeviceError, code="device.payload_mismatch"):
            arm.reset()
        proxy.heal()
        with pytest.raises(LatchedError):
            arm.execute(swing(HOME))
        time.sleep(0.2)
        arm.reset()
        assert arm.state(1.0).status is ArmStatus.READY
        assert controller_of_read_back.state()["payload"] == pytest.approx(SET.mass)
