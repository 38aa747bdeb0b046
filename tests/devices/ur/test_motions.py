"""A strike that is stopped behind the contact, on a controller that allows no more torque than the joints have."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from benchmarks.servo import wave
from benchmarks.servo_trace import compare
from tests.control.test_path_stop import GRASP, HELD, OVER_THE_NAIL
from tests.errors import raises
from tests.sim_backend.kinematics import line
from tests.stand_in import HOME, PATIENT, SERVO, held, patient, stand_in
from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, plan_strike
from toolee_robot.control.arm_dynamics import ArmDynamics, bound_stop
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import ProtectiveStopError
from toolee_robot.frames import Array
from toolee_robot.hal import MotionOutcome, MotionReport
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel, JointPlant
from toolee_robot.station import ServoConfig, sim_station
from toolee_robot.types import ArmModel, Payload, Trajectory

pytestmark = pytest.mark.realtime

HOST = "127.0.0.95"
FACTOR = 0.5
CONFIG = replace(sim_station(), strike=replace(sim_station().strike, deepest=0.1))
"""The fastest strikes ask for the most torque."""
HAMMER = Payload(1.5, np.array([0.06, 0.0, -0.05]))


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.of_station(CONFIG)


@pytest.fixture(scope="module")
def plan(robot: RobotModel) -> StrikePlan:
    world = CollisionWorld(robot, CONFIG, GRASP, HELD)
    return plan_strike(robot, CONFIG, world, OVER_THE_NAIL, GRASP, HELD, CONFIG.work.X_base_nail(), tool=HAMMER)


@pytest.fixture
def controller(plan: StrikePlan) -> Iterator[ControllerProcess]:
    plant = partial(JointPlant, q=plan.q_standoff)
    with ControllerProcess(
        model="UR10", host=HOST, plant=plant, realtime=True, real_time_factor=FACTOR, profile="harsh"
    ) as process:
        yield process


@pytest.fixture
def arm(controller: ControllerProcess, robot: RobotModel) -> Iterator[UnsupervisedUrArm]:
    servo = replace(SERVO, gain=1200.0, lookahead=0.03, lag=0.2)
    config = UrArmConfig(controller.host, servo, real_time_factor=FACTOR)
    with UnsupervisedUrArm(config, replace(sim_station().arm, model=ArmModel.UR10)) as driver:
        driver.set_payload(robot.payload(GRASP, HELD, HAMMER.mass, HAMMER.center_of_mass))
        yield driver


def stopped_at_the_contact(arm: UnsupervisedUrArm, strike: Trajectory, plan: StrikePlan) -> MotionReport:
    way = plan.q_contact - plan.q_standoff

    def stop() -> None:
        deadline = time.monotonic() + 10.0
        while (arm.state(5.0).q_commanded - plan.q_standoff) @ way < way @ way:
            assert time.monotonic() < deadline, "the arm does not strike"
            time.sleep(0.001)
        arm.stop()

    thread = threading.Thread(target=stop)
    thread.start()
    try:
        return arm.execute(strike, None, PATIENT)
    finally:
        thread.join()


def accelerations(report: MotionReport, rows: int) -> Array:
    q = report.q_commanded[:rows]
    return np.abs(np.diff(q, 2, axis=0)).max(axis=1) * 125.0**2


@pytest.mark.nightly
def test_a_stop_within_the_torques_is_no_reason_to_stop_for_the_controller(
    arm: UnsupervisedUrArm, controller: ControllerProcess, plan: StrikePlan, robot: RobotModel
) -> None:
    payload = robot.payload(GRASP, HELD, HAMMER.mass, HAMMER.center_of_mass)
    strike = bound_stop(plan.strike, ArmDynamics.with_payload(robot, GRASP, payload), ArmModel.UR10)
    report = stopped_at_the_contact(arm, strike, plan)
    assert report.outcome is MotionOutcome.STOPPED
    assert report.commands == len(report.stamps)
    assert controller.state()["safety_reason"] == ""


@pytest.mark.nightly
def test_without_a_bound_the_controller_stops_the_arm_and_no_later_command_is_reported(
    arm: UnsupervisedUrArm, plan: StrikePlan
) -> None:
    """The last command is repeated in the report, which is not to be taken for a command to stand still."""
    with raises(ProtectiveStopError, code="protective_stop.torque") as caught:
        stopped_at_the_contact(arm, plan.strike, plan)
    assert "C173A2: the motion takes more torque than the elbow has" in str(caught.value)
    report = caught.value.report
    assert report is not None
    assert report.commands is not None
    assert report.commands < len(report.stamps)
    limit = replace(sim_station().arm, model=ArmModel.UR10).stop_acceleration.max()
    assert accelerations(report, report.commands).max() <= 1.05 * limit
    assert np.all(report.q_commanded[report.commands :] == report.q_commanded[report.commands - 1])


HOST_STALLS = "127.0.0.76"
STOPS, STOP, APART = 3, 0.06, 0.25  # more than the stand-in catches up; [s], [s]


@pytest.fixture(scope="module")
def controller_of_stalls() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10E, HOST_STALLS) as process:
        yield process


@pytest.fixture(scope="module")
def arm_of_stalls(controller_of_stalls: ControllerProcess) -> Iterator[UnsupervisedUrArm]:
    with UnsupervisedUrArm(
        patient(controller_of_stalls.host), replace(sim_station().arm, model=ArmModel.UR10E)
    ) as arm_of_stalls:
        yield arm_of_stalls


@pytest.mark.nightly
@pytest.mark.parametrize("who", ["both", "stand-in", "driver"])
def test_commands_are_followed_with_the_usual_lag_after_a_standstill(
    controller_of_stalls: ControllerProcess, arm_of_stalls: UnsupervisedUrArm, who: str
) -> None:
    pids = {
        "stand-in": [controller_of_stalls.pid],
        "driver": [arm_of_stalls.servo_pid],
        "both": [controller_of_stalls.pid, arm_of_stalls.servo_pid],
    }[who]
    ended: list[float] = []

    def stop() -> None:
        for _ in range(STOPS):
            time.sleep(APART)
            for signum in (signal.SIGSTOP, signal.SIGCONT):
                for pid in pids:
                    os.kill(pid, signum)
                time.sleep(STOP if signum is signal.SIGSTOP else 0.0)
        ended.append(time.monotonic())

    before = controller_of_stalls.state()["tick"]
    timer = threading.Timer(0.5, stop)
    timer.start()
    report = arm_of_stalls.execute(wave(held(arm_of_stalls), 3.0), None, PATIENT)
    timer.join()
    assert report.outcome is MotionOutcome.COMPLETED
    trace = controller_of_stalls.trace(before)
    after = trace.stamps > ended[0] + APART
    # A command takes effect in the controller's next cycle, and the stamp is of the end of that cycle's work.
    assert compare(report, trace.stamps[after], trace.q[after], arm_of_stalls.rate).lag < 1.5 / arm_of_stalls.rate
    assert np.abs(trace.q[-1] - report.q_commanded[-1]).max() < 1e-6


HOST_MOTION_END, REAL_TIME_FACTOR = "127.0.0.29", 0.5
FREQUENCY, DAMPING = 2.0 * np.pi * 4.0, 0.15  # [rad/s], of critical


class Elastic(JointPlant):
    """Joints that swing about their set-points, as those of an arm do that leans against something."""

    def __init__(self, model: ControllerModel) -> None:
        super().__init__(model, HOME)
        self._x, self._v, self._before = np.zeros(6), np.zeros(6), np.zeros(6)

    @property
    def q(self) -> Array:
        return super().q + self._x

    @property
    def qd(self) -> Array:
        return super().qd + self._v

    def step(self, dt: float) -> None:
        super().step(dt)
        speed = super().qd
        self._v -= speed - self._before
        self._before = speed
        self._v -= dt * (FREQUENCY**2 * self._x + 2.0 * DAMPING * FREQUENCY * self._v)
        self._x = self._x + dt * self._v


@pytest.mark.nightly
def test_an_arm_that_swings_is_not_taken_for_one_that_stands() -> None:
    with (
        ControllerProcess(
            model="UR10", host=HOST_MOTION_END, plant=Elastic, realtime=True, real_time_factor=REAL_TIME_FACTOR
        ) as controller,
        UnsupervisedUrArm(
            UrArmConfig(HOST_MOTION_END, ServoConfig(lag=0.05), real_time_factor=REAL_TIME_FACTOR), sim_station().arm
        ) as arm,
    ):
        way = np.array([0.15, 0.0, 0.0, 0.0, 0.0, 0.0])
        for target in (HOME + way, HOME):
            arm.execute(line([held(arm), target], 0.5))
            tick = controller.state()["tick"]
            time.sleep(0.4 / REAL_TIME_FACTOR)
            assert np.abs(controller.trace(tick).qd).max() < 0.01


class Noisy(JointPlant):
    """Joints whose speed reads as noisily as a CB3's may: 3 mrad/s of standard deviation."""

    def __init__(self, model: ControllerModel) -> None:
        super().__init__(model, HOME)
        self._rng = np.random.default_rng(1)

    @property
    def qd(self) -> Array:
        return super().qd + self._rng.normal(0.0, 3e-3, 6)


@pytest.mark.nightly
def test_an_arm_with_noisy_encoders_is_at_rest_soon() -> None:
    with (
        ControllerProcess(model="UR10", host=HOST_MOTION_END, plant=Noisy, realtime=True) as controller,
        UnsupervisedUrArm(UrArmConfig(HOST_MOTION_END, ServoConfig(lag=0.05)), sim_station().arm) as arm,
    ):
        settling = []
        for target in (HOME + 0.05, HOME):
            report = arm.execute(line([held(arm), target], 0.5), None, PATIENT)
            settling.append(report.stamps[-1] - report.stamps[0] - 0.5)
            np.testing.assert_allclose(controller.state()["q"], target, atol=1e-3)
    assert max(settling) < 0.7, "it waited as long as it ever does"
