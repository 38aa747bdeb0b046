"""When a motion is over: not before the arm has come to rest, even where it swings past rest again and again."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tests.sim_backend.kinematics import line
from tests.stand_in import HOME, PATIENT, held
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel, JointPlant
from toolee_robot.station import ServoConfig, sim_station

pytestmark = pytest.mark.realtime

HOST, REAL_TIME_FACTOR = "127.0.0.29", 0.5
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
            model="UR10", host=HOST, plant=Elastic, realtime=True, real_time_factor=REAL_TIME_FACTOR
        ) as controller,
        UnsupervisedUrArm(
            UrArmConfig(HOST, ServoConfig(lag=0.05), real_time_factor=REAL_TIME_FACTOR), sim_station().arm
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


def test_an_arm_with_noisy_encoders_is_at_rest_soon() -> None:
    with (
        ControllerProcess(model="UR10", host=HOST, plant=Noisy, realtime=True) as controller,
        UnsupervisedUrArm(UrArmConfig(HOST, ServoConfig(lag=0.05)), sim_station().arm) as arm,
    ):
        settling = []
        for target in (HOME + 0.05, HOME):
            report = arm.execute(line([held(arm), target], 0.5), None, PATIENT)
            settling.append(report.stamps[-1] - report.stamps[0] - 0.5)
            np.testing.assert_allclose(controller.state()["q"], target, atol=1e-3)
    assert max(settling) < 0.7, "it waited as long as it ever does"
