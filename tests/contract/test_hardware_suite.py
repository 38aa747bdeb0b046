"""The contract suite as it runs on a robot, run on a controller stand-in: it commands nothing fast."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.contract.rigs import GENTLE_ACCELERATION, GENTLE_SPEED, gentle, hardware_watch
from tests.examples import examples
from tests.sim_backend.kinematics import line
from tests.stand_in import HOME, stand_in
from toolee_robot.hal import MotionWatch
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.types import ArmModel, Trajectory

HOST = "127.0.0.24"
ROOT = Path(__file__).parents[2]


@pytest.mark.nightly
@pytest.mark.realtime
@pytest.mark.parametrize("profile", ["ideal", "harsh"])
@pytest.mark.parametrize("model", ArmModel)
def test_on_a_robot_the_suite_commands_nothing_fast(model: ArmModel, profile: ProfileName) -> None:
    with stand_in(model, HOST, profile=profile) as controller:
        suite = subprocess.run(
            [sys.executable, "-m", "pytest", "-n0", "tests/contract/test_arm_contract.py", "-k", "hardware",
             "--hardware", HOST, "--hardware-model", model.value],
            cwd=ROOT, capture_output=True, text=True, check=False, timeout=300,
        )  # fmt: skip
        trace = controller.trace(0)
        rate = 125.0 if model is ArmModel.UR10 else 500.0
    assert suite.returncode == 0, suite.stdout[-3000:]
    assert " passed" in suite.stdout
    assert np.ptp(trace.q, axis=0).max() > 0.01, "it did move"
    assert np.abs(trace.qd).max() <= GENTLE_SPEED
    # Of 40 ms each: a command that comes a tick late is made up for in the next, which is nothing that was commanded.
    ticks = round(0.04 * rate)
    speeds = np.diff(trace.q[::ticks], axis=0) / 0.04
    assert np.abs(np.diff(speeds, axis=0)).max() / 0.04 <= GENTLE_ACCELERATION


def test_a_robot_is_watched_as_the_driver_does_by_itself() -> None:
    assert hardware_watch("192.168.1.10") == MotionWatch()
    assert hardware_watch(HOST).tracking_error == MotionWatch().tracking_error


@examples(50)
@given(st.floats(0.02, 4.0), st.floats(0.2, 10.0))
def test_what_is_gentle(way: float, duration: float) -> None:
    path = line([HOME, HOME + way], duration)
    speed, acceleration = np.abs(path.qd).max(), np.abs(path.qdd).max()
    assert gentle(path) == (speed <= GENTLE_SPEED and acceleration <= GENTLE_ACCELERATION)
    shorter = Trajectory(path.times / 40, path.q, path.qd, path.qdd)
    assert not gentle(shorter), "faster than its numbers say"
