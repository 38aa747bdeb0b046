"""The job with a tool mount on the flange instead of a hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.station import StationConfig, load_station
from toolee_robot.tasks.common.outcome import Outcome, Stage
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tasks.hammering.handover import MOUNT_EMPTY
from toolee_robot.tasks.hammering.task import HammeringTask

pytestmark = pytest.mark.sim(seconds=60)

SEED = 100
EXAMPLE = load_station(Path(__file__).parents[2] / "examples" / "mount.yaml")
SHORT = replace(EXAMPLE, work=replace(EXAMPLE.work, nail_protrusion=0.004))
"""A nail that a few strikes drive."""


def _task(simulation: SimStation, config: StationConfig) -> HammeringTask:
    perception = PerfectPerception(simulation.judge)
    return HammeringTask(simulation.station, perception, config, nominal_grasp(simulation.tool, config))


def _noting(answer: Callable[[str, float], bool], prompts: list[str]) -> Callable[[str, float], bool]:
    def ask(prompt: str, timeout: float) -> bool:
        prompts.append(prompt)
        return answer(prompt, timeout)

    return ask


def test_the_nail_is_driven_without_a_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    with SimStation.build(SHORT, SEED) as simulation:
        person, world, task = simulation.person, simulation.world, _task(simulation, SHORT)
        prompts: list[str] = []
        for question in ("request_handover", "confirm_inspection", "take_tool"):
            monkeypatch.setattr(person, question, _noting(getattr(person, question), prompts))
        yielded: list[float] = []
        world.after_step.append(lambda: yielded.append(float(world.robot.hand_state()[0][0])))
        result = task.run()
        assert result.outcome is Outcome.FLUSH, result.reason
        verdict = simulation.judge.verdict(result.estimates)
        assert verdict.worst().outcome == "flush"
        assert verdict.misses == 0
        assert prompts[0] == MOUNT_EMPTY
        assert "mount" in prompts[1]
        assert Stage.GRIP in result.stage_seconds
        mount = SHORT.hand.mount
        assert mount is not None
        assert 0.1 < max(yielded) < mount.travel, "the mount gave way, and did not meet its end stop"
        np.testing.assert_array_equal(simulation.station.hand.state().joints.q, [0.0])
        assert task.holds_tool
        assert task.give_back()
        assert "mount" in prompts[-1]
        assert not simulation.station.hand.state().holding
        assert world.grip is None


def test_nothing_moves_until_a_person_says_that_the_mount_is_empty() -> None:
    with SimStation.build(SHORT, SEED) as simulation:
        simulation.person.confirms = False
        before = simulation.station.arm.state().q_commanded
        result = _task(simulation, SHORT).run()
        assert result.outcome is Outcome.NOT_READY
        assert result.stage is Stage.HANDOVER
        assert "mount" in result.reason
        np.testing.assert_array_equal(simulation.station.arm.state().q_commanded, before)
