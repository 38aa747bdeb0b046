"""A computer that stands still for a moment, with the stand-in or the driver on it: the arm follows as before."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.servo import wave
from benchmarks.servo_trace import compare
from tests.stand_in import PATIENT, held, patient, stand_in
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.hal import MotionOutcome
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel

pytestmark = pytest.mark.realtime

HOST = "127.0.0.76"
STOPS, STOP, APART = 3, 0.06, 0.25  # more than the stand-in catches up; [s], [s]


@pytest.fixture(scope="module")
def controller() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10E, HOST) as process:
        yield process


@pytest.fixture(scope="module")
def arm(controller: ControllerProcess) -> Iterator[UnsupervisedUrArm]:
    with UnsupervisedUrArm(patient(controller.host), replace(sim_station().arm, model=ArmModel.UR10E)) as arm:
        yield arm


@pytest.mark.parametrize(
    "who", ["both", *(pytest.param(who, marks=pytest.mark.nightly) for who in ("stand-in", "driver"))]
)
def test_commands_are_followed_with_the_usual_lag_after_a_standstill(
    controller: ControllerProcess, arm: UnsupervisedUrArm, who: str
) -> None:
    pids = {"stand-in": [controller.pid], "driver": [arm.servo_pid], "both": [controller.pid, arm.servo_pid]}[who]
    ended: list[float] = []

    def stop() -> None:
        for _ in range(STOPS):
            time.sleep(APART)
            for signum in (signal.SIGSTOP, signal.SIGCONT):
                for pid in pids:
                    os.kill(pid, signum)
                time.sleep(STOP if signum is signal.SIGSTOP else 0.0)
        ended.append(time.monotonic())

    before = controller.state()["tick"]
    timer = threading.Timer(0.5, stop)
    timer.start()
    report = arm.execute(wave(held(arm), 3.0), None, PATIENT)
    timer.join()
    assert report.outcome is MotionOutcome.COMPLETED
    trace = controller.trace(before)
    after = trace.stamps > ended[0] + APART
    # A command takes effect in the controller's next cycle, and the stamp is of the end of that cycle's work.
    assert compare(report, trace.stamps[after], trace.q[after], arm.rate).lag < 1.5 / arm.rate
    assert np.abs(trace.q[-1] - report.q_commanded[-1]).max() < 1e-6
