"""A stand-in and its driver at another real-time factor than the wall's clock, with the bounds of a real robot."""

from __future__ import annotations

import ctypes
import gc
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from tests.sim_backend.kinematics import line
from tests.stand_in import HOME, PATIENT, held, stand_in
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import NotReadyError, UserError
from toolee_robot.hal import ContactGuard, MotionOutcome
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import ServoConfig, sim_station
from toolee_robot.types import ArmModel

HOST, REAL_TIME_FACTOR = "127.0.0.28", 0.25
SERVO = ServoConfig(lag=0.05)
WAY = np.array([0.1, 0.05, 0.0, 0.0, 0.0, 0.2])


@pytest.fixture(scope="module")
def controller() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10, HOST, REAL_TIME_FACTOR) as process:
        yield process


@pytest.fixture(scope="module")
def arm(controller: ControllerProcess) -> Iterator[UnsupervisedUrArm]:
    config = UrArmConfig(controller.host, SERVO, real_time_factor=REAL_TIME_FACTOR)
    with UnsupervisedUrArm(config, sim_station().arm) as arm:
        yield arm


@pytest.mark.nightly
@pytest.mark.realtime
def test_all_of_the_station_runs_at_its_real_time_factor_and_on_one_clock(
    controller: ControllerProcess, arm: UnsupervisedUrArm
) -> None:
    clock = HostClock(REAL_TIME_FACTOR)
    before = controller.state()
    wall, began = time.monotonic(), clock.now()
    report = arm.execute(line([held(arm), HOME + WAY], 0.8))
    took, passed = time.monotonic() - wall, clock.now() - began
    after = controller.state()
    assert report.outcome is MotionOutcome.COMPLETED
    assert took > 0.8 / REAL_TIME_FACTOR
    assert passed == pytest.approx(REAL_TIME_FACTOR * took, rel=0.05)
    # The robot's time, by its own count of cycles, is the station's.
    assert after["timestamp"] - before["timestamp"] == pytest.approx(after["stamp"] - before["stamp"], abs=0.1)
    assert np.median(np.diff(report.stamps)) == pytest.approx(1 / 125, rel=0.1)
    trace = controller.trace(before["tick"])
    half = HOME[0] + 0.5 * WAY[0]
    there = trace.stamps[np.argmax(trace.q[:, 0] > half)]
    sent = report.stamps[np.argmax(report.q_commanded[:, 0] > half)]
    assert 0.0 <= there - sent < arm.lag
    assert abs(arm.state().joints.stamp - clock.now()) < 0.1


@pytest.mark.nightly
@pytest.mark.realtime
def test_a_knock_is_no_contact_for_a_guard_that_averages_and_a_push_is(
    controller: ControllerProcess, arm: UnsupervisedUrArm
) -> None:
    guard = ContactGuard(force=15.0, averaging_window=0.2)

    def push(seconds: float) -> None:
        controller.fault("force", wrench=[0.0, 0.0, 30.0, 0.0, 0.0, 0.0], seconds=seconds)

    for seconds, outcome in ((0.03, MotionOutcome.COMPLETED), (0.6, MotionOutcome.CONTACT)):
        there = HOME if np.abs(held(arm) - HOME).max() > 0.05 else HOME + WAY
        timer = threading.Timer(0.3 / REAL_TIME_FACTOR, push, [seconds])
        timer.start()
        report = arm.execute(line([held(arm), there], 0.9), guard)
        timer.join()
        assert np.linalg.norm(report.wrenches[:, :3], axis=1).max() > guard.force
        assert report.outcome is outcome


@pytest.mark.realtime
@pytest.mark.parametrize("over", [0.0, pytest.param(0.016, marks=pytest.mark.nightly)])
def test_a_knock_among_readings_that_come_at_once_is_felt(
    controller: ControllerProcess, arm: UnsupervisedUrArm, over: float
) -> None:
    """Two cycles' knock while the network is stuck for five: when it goes on, the newest reading says nothing of it."""

    def knock() -> None:
        controller.fault("stall", port="rtde", seconds=5 / 125)
        controller.fault("force", wrench=[0.0, 0.0, 30.0, 0.0, 0.0, 0.0], seconds=2 / 125)

    there = HOME if np.abs(held(arm) - HOME).max() > 0.05 else HOME + WAY
    timer = threading.Timer(0.3 / REAL_TIME_FACTOR, knock)
    timer.start()
    report = arm.execute(line([held(arm), there], 1.2), ContactGuard(force=15.0, averaging_window=over), PATIENT)
    timer.join()
    assert report.outcome is MotionOutcome.CONTACT
    assert np.linalg.norm(report.wrenches[:, :3], axis=1).max() == pytest.approx(30.0, abs=0.1)


@pytest.mark.nightly
@pytest.mark.realtime
def test_the_collector_does_not_pause_a_task_whose_arm_moves(arm: UnsupervisedUrArm) -> None:
    """Its pause is the heartbeat's, too, and a task without one is taken for stalled."""
    heartbeat = SERVO.heartbeat_timeout / REAL_TIME_FACTOR  # [s] of the wall
    hold_all_threads = ctypes.PyDLL(None).usleep  # keeps the interpreter's lock
    ended = threading.Event()

    def pause(phase: str, _info: dict[str, int]) -> None:
        if phase == "start":
            hold_all_threads(round(2e6 * heartbeat))

    def litter() -> None:
        while not ended.wait(1e-3):
            for _ in range(200):
                loop: list[object] = []
                loop.append(loop)

    there = HOME if np.abs(held(arm) - HOME).max() > 0.05 else HOME + WAY
    task = threading.Thread(target=litter)
    timer = threading.Timer(0.3 / REAL_TIME_FACTOR, lambda: gc.callbacks.append(pause))
    task.start()
    timer.start()
    try:
        report = arm.execute(line([held(arm), there], 0.8))
    finally:
        gc.callbacks.remove(pause)
        ended.set()
        task.join()
    assert report.outcome is MotionOutcome.COMPLETED
    assert gc.isenabled()


@pytest.mark.realtime
def test_a_driver_in_real_time_refuses_a_robot_that_is_slower(controller: ControllerProcess) -> None:
    with (
        pytest.raises(NotReadyError, match="does not run in real time"),
        UnsupervisedUrArm(UrArmConfig(controller.host), sim_station().arm),
    ):
        pass


@pytest.mark.parametrize(
    ("host", "real_time_factor", "expected_text"),
    [
        ("192.168.1.10", 0.5, "a real robot runs in real time"),
        ("robot.lan", 0.5, "a real robot runs in real time"),
        ("127.0.0.2", 0.0, "0.05 to 1"),
        ("127.0.0.2", 2.0, "0.05 to 1"),
        ("127.0.0.2", float("nan"), "0.05 to 1"),
    ],
)
def test_a_real_time_factor_that_cannot_be_is_refused(host: str, real_time_factor: float, expected_text: str) -> None:
    with pytest.raises(UserError, match=expected_text):
        UrArmConfig(host, real_time_factor=real_time_factor)
