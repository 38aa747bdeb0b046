"""Strikes between two measurements of the nail, and strikes whose command turns back, on the simulated station."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.rigs.job_rig import CONFIG, Bench
from tests.tasks.bench import Log
from toolee_robot.control import RobotModel, StrikePlan
from toolee_robot.control.contact import Meeting
from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.hal import MotionReport
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.outcome import Outcome
from toolee_robot.tasks.hammering.nail_gauge import NailGauge
from toolee_robot.types import CameraError, InHandEstimate, ToolEstimate

pytestmark = pytest.mark.sim(seconds=30)

DEEPEST = CONFIG.strike.deepest


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


@pytest.mark.nightly
def test_the_command_turns_back_and_the_nail_is_driven(bench: Bench) -> None:
    config = replace(CONFIG, task=replace(CONFIG.task, max_strikes=2))
    log = Plans()
    result = bench.blind_task(log, config).run()
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    strikes, plans = log.strike_reports(), log.plans
    assert len(strikes) == 2
    # The first plan leads to the touch before the first strike.
    for plan, report in zip(plans[1:], strikes, strict=True):
        assert 0.0 < deepest(plan, report) <= DEEPEST + 1e-4
    assert [strike.meeting for strike in result.strikes] == [Meeting.EXPECTED] * 2
    assert result.protrusion == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001)
    assert config.work.nail_protrusion - bench.sim.world.nail.protrusion > 0.001


@pytest.mark.nightly
def test_a_nail_is_touched_after_its_second_strike_and_its_last_one_and_not_in_between(bench: Bench) -> None:
    config = replace(CONFIG, task=replace(CONFIG.task, max_strikes=5))
    log = Log()
    result = bench.blind_task(log, config).run()
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    assert [strike.protrusion is None for strike in result.strikes] == [True, False, True, True, False]
    assert sum(name == "touch the nail" for name in log.motions) == 3
    assert result.protrusion == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001)
    assert 0.0 < result.nail_seconds < result.robot_seconds


@pytest.mark.nightly
def test_a_strike_that_is_not_felt_is_followed_by_a_touch_which_tells_that_the_nail_was_hit(bench: Bench) -> None:
    strike = replace(CONFIG.strike, contact_force=400.0)
    config = replace(CONFIG, task=replace(CONFIG.task, max_strikes=3), strike=strike)
    log = Log()
    result = bench.blind_task(log, config).run()
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    assert all(strike.meeting in (Meeting.LATE, Meeting.NONE) for strike in result.strikes)
    assert all(strike.protrusion is not None for strike in result.strikes)
    assert result.protrusion == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001)
    assert config.work.nail_protrusion - bench.sim.world.nail.protrusion > 0.002


@pytest.mark.nightly
def test_a_touch_that_reads_flush_after_a_strike_that_was_not_felt_is_believed_only_after_a_look_and_another_strike(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a nail that it has missed the face meets the wood at once."""
    nail, work = bench.sim.world.nail, replace(CONFIG.work, nail_protrusion=0.006)
    nail.place(0.006)
    strike = replace(CONFIG.strike, contact_force=400.0)
    config = replace(CONFIG, task=replace(CONFIG.task, max_strikes=2), strike=strike, work=work)
    measure, beside_the_nail = NailGauge.measure, iter([False, True, False])

    def misread(*args: Any) -> tuple[float, HeldTool]:
        height, held = measure(*args)
        return 0.0003 if next(beside_the_nail) else height, held

    monkeypatch.setattr(NailGauge, "measure", misread)
    log = Log()
    result = bench.seeing_task(log, config, PerfectPerception(bench.sim.judge)).run()
    assert [strike.meeting is Meeting.EXPECTED for strike in result.strikes] == [False, False]
    assert result.strikes[0].protrusion == 0.0003
    between = log.motions[log.motions.index("strike") : -log.motions[::-1].index("strike") - 1]
    assert between.count("to a view") == CONFIG.task.views_again
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    assert nail.protrusion > CONFIG.task.flush_protrusion


@pytest.mark.nightly  # the job that looks is in every run
def test_a_nail_that_no_strike_was_felt_to_meet_is_not_called_flush(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The face strikes and touches the wood beside it."""
    nail, work = bench.sim.world.nail, replace(CONFIG.work, nail_protrusion=0.006)
    nail.place(0.006)
    task, strike = replace(CONFIG.task, max_strikes=5), replace(CONFIG.strike, contact_force=400.0)
    config = replace(CONFIG, task=task, strike=strike, work=work)
    measure, first = NailGauge.measure, iter([True])

    def misread(*args: Any) -> tuple[float, HeldTool]:
        height, held = measure(*args)
        return height if next(first, False) else 0.0003, held

    monkeypatch.setattr(NailGauge, "measure", misread)
    result = bench.blind_task(Log(), config).run()
    assert result.outcome is Outcome.NAIL_MISSED, result.reason
    assert "Check the nail" in result.reason
    assert nail.protrusion > config.task.flush_protrusion


@pytest.mark.nightly
@pytest.mark.parametrize("noisy", [False, True])
def test_a_nail_that_a_noisy_force_tells_to_be_flush_is_struck_once_more(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, noisy: bool
) -> None:
    nail, work = bench.sim.world.nail, replace(CONFIG.work, nail_protrusion=0.004)
    nail.place(0.004)
    config = replace(CONFIG, task=replace(CONFIG.task, max_strikes=12), work=work)
    measure = NailGauge.measure

    def too_high(*args: Any) -> tuple[float, HeldTool]:
        height, held = measure(*args)
        return max(height, 0.0004), held

    monkeypatch.setattr(NailGauge, "measure", too_high)
    monkeypatch.setattr(NailGauge, "noisy", property(lambda _: noisy))
    result = bench.blind_task(Log(), config).run()
    assert result.outcome is Outcome.FLUSH, result.reason
    *_, before, last = result.strikes
    if noisy:
        assert (before.protrusion, last.protrusion) == (0.0004, None)
        assert "before the last strike" in result.reason
    else:
        assert last.protrusion == 0.0004


class FarSighted(PerfectPerception):
    """Sees the face too far out along its normal, by the same in every look: as a camera that stands elsewhere does."""

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,
        camera: CameraError | None = None,
    ) -> InHandEstimate:
        seen = super().fuse(estimates_per_frame, Xs_camera_hand, category, camera)
        return replace(seen, X_hand_ee=seen.X_hand_ee @ transform(p=[0.0, 0.0, 0.006]))


def off_along_the_normal(bench: Bench, plans: list[StrikePlan]) -> list[float]:
    """How far each plan has the face from where it is in the end, along its normal [m]."""
    q_hand = bench.sim.station.hand.state().joints.q
    robot = RobotModel.of_station(CONFIG)
    true = inverse(bench.sim.judge.X_hand_ee(bench.sim.world.time))
    planned = [inverse(robot.fk(plan.q_contact, q_hand)[1]) @ plan.X_base_ee_contact for plan in plans]
    return [float((true @ X_hand_ee)[2, 3]) for X_hand_ee in planned]


@pytest.mark.nightly  # with correction in every run
def test_without_correction_what_the_first_touch_told_is_not_added_again(bench: Bench) -> None:
    config = replace(CONFIG, task=replace(CONFIG.task, max_strikes=CONFIG.task.strikes_between_looks + 1))
    grasp, log = bench.true_grasp, Plans()
    beyond = transform(p=[0.0, 0.0, 0.005])
    bench.true_grasp = replace(grasp, X_hand_tool=grasp.X_hand_ee @ beyond @ inverse(grasp.X_tool_ee))
    try:
        bench.blind_task(log, config).run()
    finally:
        bench.true_grasp = grasp
    first, *_, before_the_look, last = off_along_the_normal(bench, log.plans)
    assert first > 0.003, "as it was told, but for the slip of five strikes"
    assert last == pytest.approx(before_the_look, abs=0.001), "nothing was touched between the last two"


@pytest.mark.nightly
def test_what_a_touch_told_of_the_cameras_error_outlives_the_next_look(bench: Bench) -> None:
    config = replace(CONFIG, task=replace(CONFIG.task, max_strikes=CONFIG.task.strikes_between_looks + 1))
    log = Plans()
    bench.seeing_task(log, config, FarSighted(bench.sim.judge)).run()
    assert sum(name == "to a view" for name in log.motions) == CONFIG.task.views + CONFIG.task.views_again
    first, *_, last = off_along_the_normal(bench, log.plans)
    assert first > 0.004, "as it was seen, but for the slip of five strikes"
    assert abs(last) < 0.003
