"""One handover, several nails: one that is given up does not keep the next from being driven, a stop does."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.nails import with_nails
from toolee_robot.errors import DeviceError
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.station import NailConfig, StationConfig, sim_station
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import NailResult, Outcome, Strike
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tasks.hammering.task import HammeringTask

pytestmark = pytest.mark.nightly


class Told(TaskObserver):
    def __init__(self) -> None:
        self.said: list[str] = []
        self.stop_at = ""

    def nail_started(self, name: str, protrusion: float) -> None:
        self.said.append(f"{name} begins at {protrusion * 1e3:.0f} mm")

    def nail_ended(self, result: NailResult) -> None:
        self.said.append(f"{result.name}: {result.outcome}")

    def strike(self, strike: Strike) -> None:  # noqa: ARG002
        if self.said[-1].startswith(self.stop_at or "never"):
            raise DeviceError("a stop of the robot")


def _config() -> StationConfig:
    config = sim_station()
    work = replace(config.work, block_size=(0.08, 0.14, 0.06))
    return replace(
        config,
        work=with_nails(work, NailConfig("hard", (0.75, 0.12)), NailConfig("soft", (0.75, 0.08), protrusion=0.006)),
        task=replace(config.task, max_strikes=20, min_progress=0.0005),
    )


def test_a_nail_that_sticks_does_not_keep_the_next_from_being_driven() -> None:
    config, told = _config(), Told()
    with SimStation.build(config, 100) as sim:
        hard = sim.world.nails["hard"]
        hard.spec = replace(hard.spec, specific_gravity=1.2, pilot_diameter=0.0)
        task = HammeringTask(
            sim.station, PerfectPerception(sim.judge), config, nominal_grasp(sim.tool, config), observer=told
        )
        result = task.run()
        verdict = sim.judge.verdict()
    assert [(nail.name, nail.outcome) for nail in result.nails] == [("hard", Outcome.STUCK), ("soft", Outcome.FLUSH)]
    assert told.said == ["hard begins at 20 mm", "hard: stuck", "soft begins at 6 mm", "soft: flush"]
    assert result.outcome is Outcome.STUCK
    assert {nail.name: nail.outcome for nail in verdict.nails} == {"hard": "standing", "soft": "flush"}
    assert len(result.strikes) == sum(len(nail.strikes) for nail in result.nails)


def test_a_stop_ends_the_job_and_says_at_which_nail() -> None:
    config, told = _config(), Told()
    told.stop_at = "soft begins"
    with SimStation.build(config, 100) as sim:
        task = HammeringTask(
            sim.station, PerfectPerception(sim.judge), config, nominal_grasp(sim.tool, config), observer=told,
            nails=("soft", "hard"),
        )  # fmt: skip
        result = task.run()
        assert sim.world.nails["hard"].protrusion == pytest.approx(0.020, abs=1e-4)
    assert [(nail.name, nail.outcome) for nail in result.nails] == [("soft", Outcome.DEVICE_FAULT), ("hard", None)]
    assert result.reason.startswith("nail soft: ")
    assert task.resumable
