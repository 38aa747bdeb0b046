"""The matrix lists every fault of the safety page once; a failure while the machine stalled is measured again."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest

from tests.faults import matrix
from tests.faults.record import ATTEMPTS, FaultRow, Measurement, MissedMomentError, Phase
from tests.faults.rows.commands import into_itself, into_the_table
from tests.rigs.joints_path import RESOLUTION, braking_time
from tests.rigs.setting import GAIN, LOOKAHEAD, Setting
from tests.rigs.strikes import Swing, plan_swing
from tests.stalls import STALL_LIMIT
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.control.supervisor_checks import check_clear, check_limits
from toolee_robot.errors import CollisionError, LinkLostError, TooleeError
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import CB3, ProfileName
from toolee_robot.types import ArmModel, Trajectory


class Machine:
    """A latency monitor that has seen these stalls [s], one in each measurement."""

    def __init__(self, *stalls: float) -> None:
        self._stalls = list(stalls)
        self.longest = 0.0

    def begin(self) -> None:
        self.longest = self._stalls.pop(0) if self._stalls else 0.0


def measurement(*outcomes: bool | TooleeError) -> Measurement:
    left = list(outcomes)

    def run() -> FaultRow:
        outcome = left.pop(0)
        if isinstance(outcome, TooleeError):
            raise outcome
        return FaultRow(9, "connection closed", Phase.REST, "UR10", "latches", "latched", True, outcome)

    return Measurement(9, "connection closed", Phase.REST, "UR10", "latches", run)


STALL = 2 * STALL_LIMIT
MISSED = MissedMomentError("too late")


@pytest.mark.parametrize(
    ("outcomes", "stalls", "handled", "again"),
    [
        ((False,), (), False, 0),
        ((False, True), (STALL,), True, 1),
        ((False,) * ATTEMPTS, (STALL,) * ATTEMPTS, False, ATTEMPTS - 1),
        ((LinkLostError("the link is gone"),), (), False, 0),
        ((MISSED, True), (), True, 1),
        ((MISSED,) * ATTEMPTS, (), False, ATTEMPTS - 1),
    ],
)
def test_only_what_failed_while_the_machine_stalled_or_missed_its_moment_is_measured_again(
    outcomes: Any, stalls: tuple[float, ...], handled: bool, again: int
) -> None:
    machine: Any = Machine(*stalls)
    row = measurement(*outcomes).row(machine)
    assert (row.handled, row.again) == (handled, again)
    if isinstance(outcomes[-1], TooleeError):
        assert row.got == "not measured"
        assert str(outcomes[-1]) in row.why


def test_every_row_is_listed_once_and_its_number_is_on_the_safety_page() -> None:
    rows = list(matrix.matrix(list(matrix.PARTS), list(ArmModel), get_args(ProfileName)))
    names = [(row.number, row.fault, row.phase, row.on, row.expected) for row in rows]
    assert len(set(names)) == len(names)
    numbers = re.findall(r"^\| (\d+) \|", matrix.PAGE.read_text(), flags=re.MULTILINE)
    assert [int(number) for number in numbers] == sorted({row.number for row in rows})


@pytest.mark.parametrize("arguments", [["--fault", "reboot of the moon"], ["--part", "arm", "--write"]])
def test_rows_that_are_not_there_and_half_a_table_are_refused(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    listed: Callable[..., Any] = matrix.matrix
    monkeypatch.setattr(matrix, "matrix", lambda *args: listed(*args[:3]))
    with pytest.raises(SystemExit):
        matrix.main(arguments)
    assert "error" in capsys.readouterr().err


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
    assert 0.0 < harsh.rounding(path) < 2e-3, "a swing's corners"


@MODELS
def test_half_the_slider_takes_longer(model: ArmModel) -> None:
    path, at = strike(model)
    limits = plan_swing(model).config.arm
    for setting in (Setting(model, HOST), Setting(model, HOST, "harsh")):
        fast, slow = (setting.braking(path, at - setting.lag, NOTICE, limits, slider=slider) for slider in (1.0, 0.5))
        assert fast <= slow < 2.5 * fast


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


@pytest.mark.parametrize("model", ArmModel)
@pytest.mark.parametrize("command", [into_the_table, into_itself])
def test_a_motion_into_something_breaks_no_other_rule(
    model: ArmModel, command: Callable[[Swing, Array], Trajectory]
) -> None:
    """Wherever in the swing it is sent from; else its row would measure another refusal."""
    swing = plan_swing(model)
    for k in np.linspace(0, len(swing.strike.q) - 1, 7).astype(int):
        motion = command(swing, swing.strike.q[k])
        check_limits(motion, swing.robot, swing.config, swing.world)
        with pytest.raises(CollisionError):
            check_clear(motion.q, swing.world, frozenset())
