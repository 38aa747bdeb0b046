"""What can be wrong with work and people, besides the rows of the fault matrix (`tests/faults`), and what the job then
does: it stands, and keeps the grip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pybullet as pb
import pytest

from tests.rigs.job_rig import CONFIG, Bench, at_rest, grip_kept
from tests.tasks.bench import Log
from toolee_robot.control import Meeting
from toolee_robot.frames import Array
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.outcome import HammerResult, Outcome, Stage

pytestmark = pytest.mark.sim(seconds=30)


def stands(bench: Bench, result: HammerResult, outcome: Outcome, expected_text: str) -> None:
    assert result.outcome is outcome
    assert expected_text in result.reason
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


# -- people ------------------------------------------------------------------------------------------------------


def test_a_tool_from_the_last_job_is_taken_out_of_the_hand_first(bench: Bench) -> None:
    bench.hand.closed = True
    bench.people.takes = False
    log = Log()
    result = bench.blind_task(log).run()
    stands(bench, result, Outcome.NOT_READY, "Take it out first")
    assert (log.motions, bench.people.asked, bench.hand.opened) == ([], ["take"], 0)
    bench.people.takes, bench.people.gives = True, False
    bench.people.asked.clear()
    result = bench.blind_task(Log()).run()
    assert result.outcome is Outcome.NO_HANDOVER
    assert bench.people.asked[:2] == ["take", "handover"]
    assert bench.hand.opened == 1


def test_somebody_is_still_inside_after_they_said_they_stepped_back(bench: Bench) -> None:
    bench.people.on_release = bench.people.step_in
    log = Log()
    stands(bench, bench.blind_task(log).run(), Outcome.PERSON_NEAR, "within the arm's reach")
    assert log.motions == ["to the handover"]


def test_inputs_that_are_uncertain_for_a_moment_are_waited_for(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """As after a late packet: the assumed reading is the safe one, and nobody is there."""
    people, world = bench.people, bench.sim.world
    occupied, doubtful_until = people.zone_occupied, -1.0

    def doubt() -> None:
        nonlocal doubtful_until
        doubtful_until = world.time + 0.4

    monkeypatch.setattr(people, "readings_certain", lambda: world.time >= doubtful_until)
    monkeypatch.setattr(people, "zone_occupied", lambda: world.time < doubtful_until or occupied())
    result = bench.blind_task(Log(at={Stage.PLAN: doubt})).run()
    assert doubtful_until > 0.0
    assert result.outcome is not Outcome.PERSON_NEAR, result.reason
    assert result.strikes


# -- work ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stays", [pytest.param(True, marks=pytest.mark.nightly), False])
def test_a_strike_that_meets_something_too_early_is_looked_at_again_once(bench: Bench, stays: bool) -> None:
    """A plate lies over the nail: the arm brakes on it, goes up, looks again, and strikes once more."""
    config: StationConfig = replace(CONFIG, task=replace(CONFIG.task, max_strikes=2))
    client, nail = bench.sim.world.client, CONFIG.work.X_base_nail()[:3, 3]
    plates: list[int] = []

    def lay(_: Array = nail) -> None:
        shape = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=[0.03, 0.03, 0.005], physicsClientId=client)
        plates.append(pb.createMultiBody(0.0, shape, -1, [*nail[:2], nail[2] + 0.10], physicsClientId=client))

    def take_away() -> None:
        while plates:
            pb.removeBody(plates.pop(), physicsClientId=client)

    after: dict[str, Callable[[], None]] = {"to the run-up": lay}
    if not stays:
        after["up"] = lambda: log.after.update(strike=lambda: log.after.update(up=take_away))
    log = Log(after=after)
    try:
        result = bench.seeing_task(log, config).run()
    finally:
        take_away()
    assert [m for m in log.messages if "looking again" in m]
    assert len(result.estimates) == 2
    meetings = [b.meeting for b in result.strikes]
    if stays:
        assert result.outcome in (Outcome.NAIL_MISSED, Outcome.OUT_OF_STRIKES)
        assert meetings == [Meeting.EARLY, Meeting.EARLY]
        assert result.strikes[0].protrusion is None
    else:
        assert result.outcome is Outcome.OUT_OF_STRIKES
        assert meetings == [Meeting.EARLY, Meeting.EXPECTED]
        assert result.protrusion == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001)
    early = log.reports[log.motions.index("strike")]
    assert early.contact is not None
    # It braked: from the contact on not further than it takes.
    assert np.sum(early.stamps > early.contact.stamp) < 60
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)
