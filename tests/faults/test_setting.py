"""What a profile of the controller adds to the driver's own times: followed commands, never a margin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.rigs.joints_path import RESOLUTION, braking_time
from tests.rigs.setting import GAIN, LOOKAHEAD, Setting
from tests.rigs.strikes import plan_swing
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.sim_backend.ur_controller.profile import CB3
from toolee_robot.types import ArmModel, Trajectory

HOST = "127.0.0.66"
NOTICE = 0.02
MODELS = pytest.mark.parametrize("model", list(ArmModel))


def strike(model: ArmModel) -> tuple[Trajectory, float]:
    plan = plan_swing(model).plan
    return plan.strike, plan.contact_time - 0.03


@pytest.mark.parametrize(("model", "lag"), [(ArmModel.UR10, 0.054), (ArmModel.UR10E, 0.034)])
def test_the_driver_is_set_up_with_the_lag_that_a_lab_would_measure(model: ArmModel, lag: float) -> None:
    setting = Setting(model, HOST, "harsh")
    assert setting.lag == pytest.approx(lag, abs=1e-9)
    assert setting.lag < setting.servo_bound <= setting.lag + 2.001 * setting.period
    assert (setting.servo.gain, setting.servo.lookahead) == (GAIN, LOOKAHEAD)
    assert Setting(model, HOST).lag == 0.0


@MODELS
def test_an_ideal_controller_stands_as_soon_as_the_stop_ends(model: ArmModel) -> None:
    path, at = strike(model)
    setting, limits = Setting(model, HOST), plan_swing(model).config.arm
    assert setting.braking(path, at, NOTICE, limits) == braking_time(path, at + NOTICE, setting.period, limits)
    assert setting.rounding(path) == 0.0


@MODELS
def test_a_lag_takes_longer_by_itself_and_by_the_tail_of_its_filters(model: ArmModel) -> None:
    path, at = strike(model)
    ideal, harsh, limits = Setting(model, HOST), Setting(model, HOST, "harsh"), plan_swing(model).config.arm
    exact = ideal.braking(path, at, NOTICE, limits)
    behind = harsh.braking(path, at - harsh.lag, NOTICE, limits)
    # Three filters of 15 to 19 ms each: their tails fall from 2 rad/s to 2 mrad/s in less than ten time constants.
    assert exact + harsh.lag < behind < exact + harsh.lag + 10 * 0.019
    assert 0.0 < harsh.rounding(path) < 1e-3


@MODELS
def test_half_the_slider_takes_longer(model: ArmModel) -> None:
    path, at = strike(model)
    limits = plan_swing(model).config.arm
    for setting in (Setting(model, HOST), Setting(model, HOST, "harsh")):
        fast, slow = (setting.braking(path, at - setting.lag, NOTICE, limits, slider=slider) for slider in (1.0, 0.5))
        assert fast < slow < 2.5 * fast


def test_a_larger_dead_time_is_waited_for() -> None:
    path, at = strike(ArmModel.UR10)
    setting, limits = Setting(ArmModel.UR10, HOST, "harsh"), plan_swing(ArmModel.UR10).config.arm
    more = replace(CB3.servo, dead_time=CB3.servo.dead_time + 0.2)  # type: ignore[type-var, union-attr]
    usual = setting.braking(path, at - setting.lag, NOTICE, limits)
    assert setting.braking(path, at - setting.lag, NOTICE, limits, lag=more) == pytest.approx(usual + 0.2, abs=0.02)


def test_a_straight_path_is_not_rounded_off() -> None:
    straight = joint_move(np.zeros(6), np.full(6, 0.4), np.full(6, 1.0), np.full(6, 5.0), np.full(6, 100.0))
    fastest = float(np.linalg.norm(straight.qd, axis=1).max())
    assert Setting(ArmModel.UR10, HOST, "harsh").rounding(straight) < 0.51 * RESOLUTION * fastest
