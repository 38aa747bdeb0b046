"""However the servo process ends, it leaves no program that Play could resume."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.devices.ur.swings import LONG, braked, stop_after, swing
from tests.devices.ur.test_driver_faults import plays_in_vain
from tests.examples import timed
from tests.stand_in import patient, stand_in
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.devices.ur.servo.program_watch import ProgramWatch, WatchedProgram
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel

pytestmark = pytest.mark.realtime

HOST = "127.0.0.77"
LIMITS = replace(sim_station().arm, model=ArmModel.UR10)
WATCHDOG = 1.0 / patient(HOST).servo.watchdog


@pytest.fixture(scope="module")
def shared() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10, HOST) as process:
        yield process


@pytest.fixture
def controller(shared: ControllerProcess) -> Iterator[ControllerProcess]:
    yield shared
    shared.fault("reset")


def watching() -> list[int]:
    """Ids of this process's children that watch a program."""
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    return [int(pid) for pid in children if b"program_watch" in Path(f"/proc/{pid}/cmdline").read_bytes()]


@pytest.mark.nightly
def test_an_arm_that_is_closed_without_its_link(controller: ControllerProcess) -> None:
    with UnsupervisedUrArm(patient(HOST), LIMITS):
        controller.fault("protective_stop")
        controller.fault("drop", port="rtde", reset=True)
    plays_in_vain(controller)
    assert not watching()


@pytest.mark.nightly  # without one of its links in every run
def test_an_arm_that_is_closed_without_any_link_says_so(controller: ControllerProcess) -> None:
    with ExitStack() as opened:
        opened.enter_context(UnsupervisedUrArm(patient(HOST), LIMITS))
        controller.fault("protective_stop")
        for port in ("dashboard", "rtde"):
            controller.fault("refuse", port=port)
            controller.fault("drop", port=port, reset=True)
        with pytest.warns(RuntimeWarning, match="stop the program at the pendant"):
            opened.close()
    assert controller.state()["program_state"] == "PAUSED"
    controller.fault("accept")
    time.sleep(1.0)
    plays_in_vain(controller)


@timed
def test_a_servo_process_that_dies_at_rest_unnoticed(controller: ControllerProcess, timed: bool) -> None:
    with UnsupervisedUrArm(patient(HOST), LIMITS) as arm:
        os.kill(arm.servo_pid, signal.SIGKILL)
        controller.fault("protective_stop")
        plays_in_vain(controller, within=2.0 * WATCHDOG + 0.5 if timed else 10.0)  # the task asks nothing meanwhile


@pytest.mark.nightly
def test_task_and_servo_process_die_at_once(controller: ControllerProcess) -> None:
    command = [sys.executable, "-m", "tests.devices.ur.swings", HOST, "UR10"]
    task = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert task.stdout is not None
        _, servo = task.stdout.readline().split()
        task.kill()
        os.kill(int(servo), signal.SIGKILL)
        controller.fault("protective_stop")
        plays_in_vain(controller, within=2.0 * WATCHDOG + 0.8)
    finally:
        task.kill()
        task.wait()


def test_servo_process_and_watch_die_at_once(controller: ControllerProcess) -> None:
    """The task's process is left, which notices when it next uses the arm."""
    with UnsupervisedUrArm(patient(HOST), LIMITS) as arm:
        for pid in (*watching(), arm.servo_pid):
            os.kill(pid, signal.SIGKILL)
        controller.fault("protective_stop")
    plays_in_vain(controller)


@pytest.mark.nightly
def test_a_program_of_somebody_else_is_left_alone(controller: ControllerProcess) -> None:
    """The driver's own has ended before; what a person starts afterwards is not the driver's to end."""
    with UnsupervisedUrArm(patient(HOST), LIMITS) as arm:
        controller.fault("pause")
        time.sleep(0.5)
        assert controller.state()["program_state"] == "STOPPED"
        upload(controller, "def other():\n  while True:\n    sync()\n  end\nend\n")
        os.kill(arm.servo_pid, signal.SIGKILL)
        time.sleep(2.0 * WATCHDOG + 0.8)
        assert controller.state()["program_state"] == "PLAYING"


@pytest.mark.nightly
def test_a_stopped_robot_has_its_program_ended_at_once_and_a_moving_one_by_its_watchdog_first(
    controller: ControllerProcess,
) -> None:
    """A program that plays is the watchdog's to end, for which the watching process waits."""
    for stopped, delay in ((True, 60.0), (False, 4.0)):
        upload(controller, "def ours():\n  while True:\n    sync()\n  end\nend\n")
        watch = ProgramWatch(HOST, delay)
        WatchedProgram(watch.fd).begun()
        began = time.monotonic()
        if stopped:
            controller.fault("protective_stop")
        watch.hand_over()
        if not stopped:
            time.sleep(0.5 * delay)
            assert controller.state()["program_state"] == "PLAYING"
        assert watch.ended(5.0)
        assert time.monotonic() - began < 30.0
        plays_in_vain(controller)
        controller.fault("reset")


def upload(controller: ControllerProcess, script: str) -> None:
    """Start a program as another client does."""
    with socket.create_connection((controller.host, 30002)) as sock:
        sock.sendall(script.encode())
        time.sleep(0.3)


HOST_TASK_DEATH = "127.0.0.24"
LIMITS_TASK_DEATH = sim_station().arm
HEARTBEAT = patient(HOST_TASK_DEATH).servo.heartbeat_timeout


@pytest.fixture(scope="module")
def controller_of_task_death() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10, HOST_TASK_DEATH) as process:
        yield process


SIGNALS = [
    pytest.param(signal.SIGKILL, 0.0, "", False, id="SIGKILL"),
    pytest.param(signal.SIGKILL, 0.0, "", True, id="SIGKILL, timed", marks=pytest.mark.nightly),
    pytest.param(signal.SIGSTOP, HEARTBEAT, "", True, id="SIGSTOP", marks=pytest.mark.nightly),
    pytest.param(signal.SIGINT, 0.0, "interrupted", True, id="SIGINT", marks=pytest.mark.nightly),
]


@pytest.mark.parametrize(("number", "detection", "last_words", "timed"), SIGNALS)
def test_what_hits_the_task(
    controller_of_task_death: ControllerProcess, number: int, detection: float, last_words: str, timed: bool
) -> None:
    host = controller_of_task_death.host
    controller_of_task_death.fault("reset")
    before = controller_of_task_death.state()["tick"]
    trajectory = swing(np.array(controller_of_task_death.state()["q"]), LONG)
    task = subprocess.Popen(
        [sys.executable, "-m", "tests.devices.ur.swings", host, "UR10"], stdout=subprocess.PIPE, text=True
    )
    try:
        assert task.stdout is not None
        assert task.stdout.readline().startswith("swinging")
        event = time.monotonic()
        task.send_signal(number)
        if last_words:
            assert task.stdout.readline().startswith(last_words)
            assert task.wait(5.0) != 0
        time.sleep(1.0 + detection)
        stop = stop_after(controller_of_task_death.trace(before), trajectory, event)
        braked(stop, LIMITS_TASK_DEATH, detection, timed=timed)
        if number == signal.SIGSTOP:
            task.send_signal(signal.SIGCONT)
            assert task.stdout.readline().strip() == "MotionFaultError"
    finally:
        task.kill()
        task.wait()
