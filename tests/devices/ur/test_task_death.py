"""What befalls the task's own process: killed, stopped, interrupted. The servo process brakes the arm on its path; the
joints of the controller stand-in tell."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest

from tests.devices.ur.swings import LONG, braked, stop_after, swing
from tests.stand_in import patient, stand_in
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel

pytestmark = pytest.mark.realtime

HOST = "127.0.0.24"
LIMITS = sim_station().arm
HEARTBEAT = patient(HOST).servo.heartbeat_timeout


@pytest.fixture(scope="module")
def controller() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10, HOST) as process:
        yield process


SIGNALS = [
    pytest.param(signal.SIGKILL, 0.0, "", id="SIGKILL"),
    pytest.param(signal.SIGSTOP, HEARTBEAT, "", id="SIGSTOP", marks=pytest.mark.nightly),
    pytest.param(signal.SIGINT, 0.0, "interrupted", id="SIGINT", marks=pytest.mark.nightly),
]


@pytest.mark.parametrize(("number", "detection", "last_words"), SIGNALS)
def test_what_hits_the_task(controller: ControllerProcess, number: int, detection: float, last_words: str) -> None:
    host = controller.host
    controller.fault("reset")
    before = controller.state()["tick"]
    trajectory = swing(np.array(controller.state()["q"]), LONG)
    task = subprocess.Popen(
        [sys.executable, "-m", "tests.devices.ur.swinging_task", host, "UR10"], stdout=subprocess.PIPE, text=True
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
        braked(stop_after(controller.trace(before), trajectory, event), LIMITS, detection)
        if number == signal.SIGSTOP:
            task.send_signal(signal.SIGCONT)
            assert task.stdout.readline().strip() == "MotionFaultError"
    finally:
        task.kill()
        task.wait()
