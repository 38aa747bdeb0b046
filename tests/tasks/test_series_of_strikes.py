"""Strikes between two measurements of the nail, and strikes whose command turns back, on the simulated station."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.tasks.bench import Log
from toolee_robot.control import RobotModel, StrikePlan
from toolee_robot.control.contact import Meeting
from toolee_robot.faults.rigs.job_rig import CONFIG, Bench
from toolee_robot.frames import inverse
from toolee_robot.hal import MotionReport
from toolee_robot.tasks.common.outcome import Outcome

pytestmark = pytest.mark.sim(seconds=30)

DEEPEST = 0.010


class Plans(Log):
    """Keeps the plans, too."""

    def __init__(self) -> None:
        super().__init__()
        self.plans: list[StrikePlan] = []

    def planned(self, stamp: float, plan: StrikePlan) -> None:
        self.plans.append(plan)
        super().planned(stamp, plan)

    def strike_reports(self) -> list[MotionReport]:
        return [report for name, report in zip(self.motions, self.reports, strict=True) if name == "strike"]


def deepest(plan: StrikePlan, report: MotionReport) -> float:
    """Largest distance of the commanded face beyond the contact [m]."""
    fk = RobotModel.of_station(CONFIG).arm.fk
    X_flange_ee = inverse(fk(plan.q_contact)) @ plan.X_base_ee_contact
    contact, normal = plan.X_base_ee_contact[:3, 3], plan.X_base_ee_contact[:3, 2]
    return float(np.max(((fk(report.q_commanded) @ X_flange_ee)[:, :3, 3] - contact) @ normal))


def test_with_a_deepest_place_the_command_turns_back_and_the_nail_is_driven(bench: Bench) -> None:
    config = replace(CONFIG, task=replace(CONFIG.task, max_strikes=2), strike=replace(CONFIG.strike, deepest=DEEPEST))
    log = Plans()
    result = bench.blind_task(log, config).run()
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    strikes, plans = log.strike_reports(), [plan for plan in log.plans if plan.brake_length <= DEEPEST]
    assert len(strikes) == 2
    # The first plan leads to the touch before the first strike.
    for plan, report in zip(plans[1:], strikes, strict=True):
        assert 0.0 < deepest(plan, report) <= DEEPEST + 1e-4
    assert [strike.meeting for strike in result.strikes] == [Meeting.EXPECTED] * 2
    assert result.protrusion == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001)
    assert config.work.nail_protrusion - bench.sim.world.nail.protrusion > 0.001


def test_a_nail_is_touched_after_its_first_strike_and_its_last_one_and_not_in_between(bench: Bench) -> None:
    config = replace(CONFIG, task=replace(CONFIG.task, max_strikes=4))
    log = Log()
    result = bench.blind_task(log, config).run()
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    assert [strike.protrusion is None for strike in result.strikes] == [False, True, True, False]
    assert sum(name == "touch the nail" for name in log.motions) == 3
    assert result.protrusion == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001)
    assert 0.0 < result.nail_seconds < result.robot_seconds
