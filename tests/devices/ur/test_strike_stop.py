"""A strike that is stopped behind the contact, on a controller that allows no more torque than the joints have."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tests.control.test_stop_torque import GRASP, HELD, OVER_THE_NAIL
from tests.errors import raises
from tests.stand_in import PATIENT, SERVO
from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, plan_strike
from toolee_robot.control.arm_dynamics import bound_stop
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import ProtectiveStopError
from toolee_robot.frames import Array
from toolee_robot.hal import MotionOutcome, MotionReport
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.robot.plant import JointPlant
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel, Payload, Trajectory

pytestmark = pytest.mark.realtime

HOST = "127.0.0.95"
FACTOR = 0.5
CONFIG = sim_station()
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


def test_a_stop_within_the_torques_is_no_reason_to_stop_for_the_controller(
    arm: UnsupervisedUrArm, controller: ControllerProcess, plan: StrikePlan, robot: RobotModel
) -> None:
    payload = robot.payload(GRASP, HELD, HAMMER.mass, HAMMER.center_of_mass)
    strike = bound_stop(plan.strike, robot, ArmModel.UR10, GRASP, payload)
    report = stopped_at_the_contact(arm, strike, plan)
    assert report.outcome is MotionOutcome.STOPPED
    assert report.commands == len(report.stamps)
    assert controller.state()["safety_reason"] == ""


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
    limit = replace(sim_station().arm, model=ArmModel.UR10).stop_acceleration
    assert accelerations(report, report.commands).max() <= 1.05 * limit
    assert np.all(report.q_commanded[report.commands :] == report.q_commanded[report.commands - 1])
