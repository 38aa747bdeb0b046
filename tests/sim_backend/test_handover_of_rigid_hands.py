"""A person lays a hammer into a hand whose thumb stands before the palm, and no finger throws the arm."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from tests.examples import seldom
from tests.tasks.bench import noting
from toolee_robot.app.simulated import Simulated
from toolee_robot.control import CollisionWorld, RobotModel, plan_handover
from toolee_robot.frames import transform
from toolee_robot.hal import ArmStatus
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.devices.operator import SimPerson
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.station import load_station
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import Stage
from toolee_robot.tasks.hammering.task import HammeringTask

pytestmark = pytest.mark.sim(seconds=8)

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize("hand", seldom("inspire", "ability"))
@pytest.mark.parametrize("seed", seldom(7403, 3, 7486, 15023, 15034))
def test_the_hand_closes_around_it_and_the_arm_does_not_stop(hand: str, seed: int) -> None:
    """7403: tilted, it meets the thumb. 7486, 15023, 15034: it fits behind the thumb nearer to the fingertips."""
    config = load_station(EXAMPLES / f"{hand}.yaml")
    with SimStation.build(config, seed, SimOptions(wrench_errors=1.0, compliance=1.0)) as simulation:
        station, robot = simulation.station, RobotModel.of_station(config)
        station.hand.open()
        q_hand = station.hand.state().joints.q
        q = station.arm.state().joints.q
        station.arm.execute(plan_handover(robot, config, CollisionWorld(robot, config, q_hand), q, q_hand))
        assert station.person.request_handover("", 10.0)
        assert np.linalg.norm(station.arm.state().wrench[:3]) < 30.0, "the person presses it against the hand"
        station.hand.close()
        state = station.hand.state()
        assert station.person.release("", 10.0)
        assert state.holding
        assert state.assisted
        assert max(state.contact_forces.values()) <= robot.description.hand.finger_force + 1e-9
        assert station.arm.state().status is ArmStatus.READY


def _quiet(_: str) -> None: ...


class Looks(Exception):
    """Ends the job."""


class UntilLook(TaskObserver):
    def stage_started(self, stage: Stage) -> None:
        if stage is Stage.VIEW:
            raise Looks


@pytest.mark.nightly
def test_a_hand_that_closed_on_nothing_is_given_another_place_of_the_handle(monkeypatch: pytest.MonkeyPatch) -> None:
    """The person first holds the tool where the fingers do not reach it."""
    prompts: list[str] = []
    with Simulated(load_station(EXAMPLES / "ability.yaml"), 3).open(_quiet, _quiet) as opened:
        person = opened.station.person
        assert isinstance(person, SimPerson)
        place, places = person._clear_of_hand, iter([transform(p=[0.0, -0.1, 0.0])])
        monkeypatch.setattr(person, "_clear_of_hand", lambda offset: place(offset) @ next(places, np.eye(4)))
        for name in ("request_handover", "release"):
            monkeypatch.setattr(person, name, noting(getattr(person, name), prompts))
        assert opened.truth is not None
        perception = PerfectPerception(opened.truth)
        task = HammeringTask(opened.station, perception, opened.config, opened.grasp, observer=UntilLook())
        with suppress(Looks):
            task.run()
        assert "open hand" in prompts[0]
        assert "holds nothing" in prompts[1]
        assert "step back" in prompts[-1], "not before the hand holds it"
        assert task.holds_tool
