"""The arm halts, whatever happens to the task, to the servo process, to the network or to the robot: asserted on the
joints of the controller stand-in, not on what the driver says of itself."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tests.devices.ur.swings import SLACK, Stop, stop_after, swing, wait_for_mid_swing
from tests.errors import raises
from tests.stand_in import HOME, PATIENT, held, patient, stand_in
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import (
    DeviceError,
    EmergencyStopError,
    LatchedError,
    LinkLostError,
    MotionFaultError,
    NotReadyError,
    ProtectiveStopError,
    ServoCrashError,
    StaleDataError,
)
from toolee_robot.hal import ArmStatus, MotionOutcome, MotionWatch
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel

pytestmark = pytest.mark.realtime

HOST = "127.0.0.23"
LIMITS = replace(sim_station().arm, model=ArmModel.UR10)
CONFIG = patient(HOST)
WATCHDOG = 1.0 / CONFIG.servo.watchdog


@pytest.fixture(scope="module")
def controller() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10, HOST) as process:
        yield process


@pytest.fixture(scope="module")
def shared_arm(controller: ControllerProcess) -> Iterator[UnsupervisedUrArm]:
    with UnsupervisedUrArm(patient(controller.host), LIMITS) as arm:
        yield arm


@pytest.fixture
def arm(shared_arm: UnsupervisedUrArm, controller: ControllerProcess) -> Iterator[UnsupervisedUrArm]:
    """Ready, wherever on the way it stands."""
    deadline = time.monotonic() + 20.0
    while True:
        try:
            shared_arm.reset()
            break
        except DeviceError:
            assert time.monotonic() < deadline
            time.sleep(0.1)
    yield shared_arm
    controller.fault("reset")  # ends the program too, which the arm has to see
    time.sleep(0.2)


def happens(
    arm: UnsupervisedUrArm, controller: ControllerProcess, event: Callable[[], object], watch: MotionWatch = PATIENT
) -> tuple[Stop, Exception | None]:
    """A swing in the middle of which `event` happens, and how the joints stopped."""
    trajectory = swing(held(arm))
    before = controller.state()["tick"]
    at: list[float] = []

    def act() -> None:
        wait_for_mid_swing(arm, trajectory)
        at.append(time.monotonic())
        event()

    timer = threading.Thread(target=act)
    timer.start()
    error: Exception | None = None
    try:
        report = arm.execute(trajectory, None, watch)
        assert report.outcome is not MotionOutcome.COMPLETED
    except DeviceError as fault:
        error = fault
    timer.join()
    time.sleep(0.5)
    stop = stop_after(controller.trace(before), trajectory, at[0])
    assert stop.speed > 0.5, "it was to happen in mid-swing"
    return stop, error


def expect_latch(arm: UnsupervisedUrArm) -> None:
    with pytest.raises(LatchedError):
        arm.execute(swing(held(arm)))


def test_emergency_stop(arm: UnsupervisedUrArm, controller: ControllerProcess) -> None:
    _, error = happens(arm, controller, lambda: controller.fault("emergency_stop"))
    assert isinstance(error, EmergencyStopError)
    expect_latch(arm)
    with raises(NotReadyError, code="not_ready.emergency_stop"):
        arm.reset()


PAUSES: dict[str, tuple[Callable[[ControllerProcess], object], Callable[[ControllerProcess], object]]] = {
    "protective stop": (lambda c: c.fault("protective_stop"), lambda c: c.fault("unlock")),
    "safeguard stop": (lambda c: c.fault("safeguard_stop"), lambda c: c.fault("safeguard_stop", active=False)),
    "pause at the pendant": (lambda c: c.fault("pause"), lambda _c: None),
}


def plays_in_vain(
    controller: ControllerProcess,
    release: Callable[[ControllerProcess], object] = PAUSES["protective stop"][1],
    within: float = 0.0,
) -> None:
    """The robot's program is ended in time [s]: after the release Play resumes nothing, and the joints stay."""
    deadline = time.monotonic() + within
    while controller.state()["program_state"] != "STOPPED" and time.monotonic() < deadline:
        time.sleep(0.02)
    assert controller.state()["program_state"] == "STOPPED"
    before = controller.state()["tick"]
    release(controller)
    assert not controller.fault("play")["resumed"]
    time.sleep(0.5)
    q = controller.trace(before).q
    assert np.ptp(q, axis=0).max() == 0.0


@pytest.mark.parametrize(
    "pause",
    [pytest.param(p, marks=() if p == "protective stop" else pytest.mark.nightly) for p in PAUSES],
)
def test_play_after_a_stop_never_resumes_the_old_motion(
    arm: UnsupervisedUrArm, controller: ControllerProcess, pause: str
) -> None:
    stop, release = PAUSES[pause]
    _, error = happens(arm, controller, lambda: stop(controller))
    assert isinstance(error, MotionFaultError)
    plays_in_vain(controller, release, within=10.0)
    expect_latch(arm)
    arm.reset()
    assert arm.execute(swing(held(arm)), None, PATIENT).outcome is MotionOutcome.COMPLETED


@pytest.mark.nightly
def test_the_program_ends_although_the_dashboard_was_restarted(
    arm: UnsupervisedUrArm, controller: ControllerProcess
) -> None:
    controller.fault("drop", port="dashboard", reset=True)
    _, error = happens(arm, controller, lambda: controller.fault("protective_stop"))
    assert isinstance(error, ProtectiveStopError)
    plays_in_vain(controller)


@pytest.mark.nightly
def test_the_program_ends_when_the_servo_process_dies_beside_a_protective_stop(
    arm: UnsupervisedUrArm, controller: ControllerProcess
) -> None:
    """A paused program's watchdog does not count, so that the dead process leaves a program that could go on."""

    def both() -> None:
        os.kill(arm.servo_pid, signal.SIGKILL)
        controller.fault("protective_stop")

    _, error = happens(arm, controller, both)
    assert isinstance(error, MotionFaultError)
    plays_in_vain(controller)


LINK_FIRST, STOP_FIRST = "link first", "stop first"
nightly = pytest.mark.nightly


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("pause", "order", "between"),
    [
        ("protective stop", STOP_FIRST, 0.0),
        pytest.param("protective stop", LINK_FIRST, 0.0, marks=nightly),
        pytest.param("protective stop", LINK_FIRST, 0.02, marks=nightly),
        pytest.param("protective stop", STOP_FIRST, 0.005, marks=nightly),
        pytest.param("safeguard stop", LINK_FIRST, 0.0, marks=nightly),
        pytest.param("safeguard stop", STOP_FIRST, 0.0, marks=nightly),
        pytest.param("pause at the pendant", LINK_FIRST, 0.0, marks=nightly),
        pytest.param("pause at the pendant", STOP_FIRST, 0.0, marks=nightly),
    ],
)
def test_the_program_ends_when_the_link_is_lost_beside_a_stop(
    arm: UnsupervisedUrArm, controller: ControllerProcess, pause: str, order: str, between: float
) -> None:
    """The stop is not seen any more, and in a paused program the watchdog does not count."""
    stop, release = PAUSES[pause]

    def both() -> None:
        for event in (LINK_FIRST, STOP_FIRST) if order == LINK_FIRST else (STOP_FIRST, LINK_FIRST):
            if event == STOP_FIRST:
                stop(controller)
            else:
                controller.fault("drop", port="rtde", reset=True)
            time.sleep(between)

    _, error = happens(arm, controller, both)
    assert isinstance(error, MotionFaultError)
    plays_in_vain(controller, release)
    expect_latch(arm)
    arm.reset()
    assert arm.execute(swing(held(arm)), None, PATIENT).outcome is MotionOutcome.COMPLETED


@pytest.mark.nightly
def test_a_program_that_cannot_be_ended_after_a_lost_link_is_ended_when_the_dashboard_is_back(
    arm: UnsupervisedUrArm, controller: ControllerProcess
) -> None:
    """Until then the driver says so, and refuses the reset."""

    def lose() -> None:
        for port in ("dashboard", "rtde"):
            controller.fault("refuse", port=port)
            controller.fault("drop", port=port, reset=True)
        controller.fault("protective_stop")

    _, error = happens(arm, controller, lose)
    assert isinstance(error, LinkLostError)
    assert "stop the program at the pendant" in str(error)
    assert controller.state()["program_state"] == "PAUSED"
    controller.fault("accept", port="rtde")
    controller.fault("unlock")
    with raises(NotReadyError, code="not_ready.checks_failed") as refused:
        arm.reset()
    assert "paused program" in str(refused.value)
    controller.fault("accept", port="dashboard")
    time.sleep(1.0)
    plays_in_vain(controller)


@pytest.mark.nightly
def test_a_program_that_cannot_be_ended_forbids_the_reset(
    arm: UnsupervisedUrArm, controller: ControllerProcess
) -> None:
    """The dashboard is unreachable from before the stop on: the paused program stays, and the driver says so."""
    controller.fault("refuse", port="dashboard", seconds=60.0)
    controller.fault("drop", port="dashboard", reset=True)
    controller.fault("protective_stop")
    time.sleep(0.5)
    controller.fault("unlock")
    assert controller.state()["program_state"] == "PAUSED"
    time.sleep(0.1)
    with raises(NotReadyError, code="not_ready.checks_failed") as refused:
        arm.reset()
    assert "paused program" in str(refused.value)


@pytest.mark.parametrize(
    ("fault", "arguments", "finding"),
    [
        ("serial", {"number": "20199900001"}, "serial number"),
        pytest.param("speed_slider", {"fraction": 0.5}, "speed slider", marks=pytest.mark.nightly),
    ],
)
def test_reset_refuses_another_robot_and_another_speed(
    arm: UnsupervisedUrArm, controller: ControllerProcess, fault: str, arguments: dict[str, object], finding: str
) -> None:
    controller.fault("protective_stop")
    time.sleep(0.3)
    controller.fault("unlock")
    controller.fault(fault, **arguments)
    time.sleep(0.1)
    with raises(NotReadyError, code="not_ready.checks_failed") as refused:
        arm.reset()
    assert finding in str(refused.value)


@contextmanager
def halting(controller: ControllerProcess) -> Iterator[None]:
    """The controller stands still for most of the time, as a simulator on a busy machine."""
    ended = threading.Event()

    def halt() -> None:
        while not ended.wait(0.35):
            controller.fault("freeze", seconds=0.3)

    thread = threading.Thread(target=halt)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@pytest.mark.nightly
def test_a_reset_that_meets_late_readings_alone_says_so(arm: UnsupervisedUrArm, controller: ControllerProcess) -> None:
    controller.fault("protective_stop")
    time.sleep(0.3)
    controller.fault("unlock")
    with halting(controller), raises(NotReadyError, code="not_ready.timing") as refused:
        arm.reset()
    assert "clock" in str(refused.value)
    arm.reset()
    assert arm.execute(swing(held(arm)), None, PATIENT).outcome is MotionOutcome.COMPLETED


@pytest.mark.nightly
def test_a_controller_that_pauses_at_rest_is_stale_meanwhile_and_no_more(
    arm: UnsupervisedUrArm, controller: ControllerProcess
) -> None:
    pid = arm.servo_pid
    time.sleep(0.1)
    controller.fault("freeze", seconds=0.8)
    time.sleep(0.5)
    with pytest.raises(StaleDataError):
        arm.state(0.1)
    time.sleep(1.0)
    assert arm.state(0.5).status is ArmStatus.READY
    arm.reset()
    assert arm.servo_pid == pid
    assert arm.execute(swing(held(arm)), None, PATIENT).outcome is MotionOutcome.COMPLETED


@pytest.mark.nightly
def test_a_stall_of_three_seconds_is_a_lost_link(arm: UnsupervisedUrArm, controller: ControllerProcess) -> None:
    controller.fault("stall", seconds=3.0, port="rtde")
    time.sleep(2.2)
    with pytest.raises(LatchedError, match="link"):
        arm.execute(swing(HOME))
    time.sleep(1.0)


@pytest.mark.nightly
def test_killed_servo_process(arm: UnsupervisedUrArm, controller: ControllerProcess) -> None:
    stop, error = happens(arm, controller, partial(os.kill, arm.servo_pid, signal.SIGKILL))
    assert isinstance(error, ServoCrashError)
    assert "SIGKILL" in str(error)
    assert error.report is not None
    assert len(error.report.stamps) > 10
    assert stop.time < WATCHDOG + 0.4 + SLACK
    expect_latch(arm)
