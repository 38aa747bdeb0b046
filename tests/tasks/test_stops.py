"""A job that was stopped with the hammer in the hand: it goes on after a person, or the person takes the hammer out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pybullet as pb
import pytest

from tests.errors import raises
from tests.rigs.job_rig import CONFIG, Bench, at_rest, grip_kept
from tests.rigs.people import People
from tests.tasks.bench import Log, soon
from toolee_robot.app.job import after_stop
from toolee_robot.app.sources import JobObserver
from toolee_robot.control import Meeting, StrikePlan
from toolee_robot.errors import DeviceError, NotReadyError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmStatus
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.outcome import MAX_STOPS, RESUME, TAKE_OUT, HammerResult, Outcome, Stage
from toolee_robot.tasks.common.watches import MAX_DOUBTS
from toolee_robot.tasks.hammering.task import HammeringTask

pytestmark = pytest.mark.sim(seconds=110)


@pytest.fixture
def log() -> Log:
    return Log()


@pytest.fixture
def stopped(bench: Bench, log: Log) -> tuple[HammeringTask, HammerResult]:
    """Somebody is within reach as the nail is about to be touched."""
    log.at[Stage.TOUCH] = bench.people.step_in
    task = bench.blind_task(log)
    result = task.run()
    assert result.outcome is Outcome.PERSON_NEAR
    assert RESUME in result.reason
    return task, result


def test_three_stops_end_the_session(bench: Bench, log: Log, stopped: tuple[HammeringTask, HammerResult]) -> None:
    task, result = stopped
    for _ in range(MAX_STOPS - 1):
        assert task.resumable
        with raises(DeviceError, "device.reset_not_confirmed"):
            task.resume()
        result = task.resume(confirmed=True)  # they are still there
        assert result.outcome is Outcome.PERSON_NEAR
    assert TAKE_OUT in result.reason
    assert not task.resumable
    assert result.stops == MAX_STOPS
    with raises(NotReadyError, "not_ready.nothing_to_resume"):
        task.resume(confirmed=True)
    assert log.motions == ["to the handover"]
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


def test_a_job_that_has_ended_cannot_be_resumed(bench: Bench) -> None:
    bench.people.gives = False
    task = bench.blind_task(Log())
    assert not task.resumable
    assert task.run().outcome is Outcome.NO_HANDOVER
    assert not task.resumable


def test_a_stop_that_cannot_be_cleared_says_how_to_take_the_hammer_out(
    bench: Bench, log: Log, stopped: tuple[HammeringTask, HammerResult]
) -> None:
    task, _ = stopped
    bench.arm.emergency_stop()
    moved = len(log.motions)
    result = task.resume(confirmed=True)
    assert result.outcome is Outcome.DEVICE_FAULT
    assert TAKE_OUT in result.reason
    assert bench.hand.opened == 1, "once, for the handover"
    bench.people.takes = False
    assert not task.give_back()
    assert (bench.hand.opened, task.holds_tool) == (1, True), "never without a person"
    bench.people.takes = True
    assert task.give_back()
    assert (bench.hand.opened, task.holds_tool, task.resumable) == (2, False, False)
    assert len(log.motions) == moved, "the arm does not move for it"


@pytest.mark.nightly
def test_a_hand_that_doubts_again_and_again_ends_the_job(bench: Bench, log: Log) -> None:
    """A passing doubt is answered by a new look; the third one without a strike in between needs a person."""

    def blink() -> None:
        bench.hand.blinks = 1

    class Blinking(Log):
        def planned(self, stamp: float, plan: StrikePlan) -> None:
            super().planned(stamp, plan)
            soon(bench, blink, 0.3)()

    log = Blinking()
    task = bench.blind_task(log)
    with bench.in_real_time():
        result = task.run()
    assert result.outcome is Outcome.DEVICE_FAULT
    assert "doubted its grip" in result.reason
    assert task.resumable
    assert log.motions.count("to the touch") == MAX_DOUBTS
    assert "strike" not in log.motions
    assert len([message for message in log.messages if "looking again" in message]) == MAX_DOUBTS - 1
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


# -- at the terminal -------------------------------------------------------------------------------------------------


class Person(JobObserver):
    """Answers from a list, then hangs up."""

    def __init__(self, *answers: str | Callable[[], str]) -> None:
        self._left = list(answers)

    def ask(self, question: str) -> str:
        assert question.endswith("? ")
        if not self._left:
            raise EOFError
        answer = self._left.pop(0)
        return answer if isinstance(answer, str) else answer()


@pytest.mark.nightly
def test_a_person_at_the_terminal_resumes_it(
    bench: Bench, log: Log, stopped: tuple[HammeringTask, HammerResult]
) -> None:
    task, result = stopped

    def leave() -> str:
        bench.people.is_inside = False
        return "r"

    result = after_stop(task, result, Person("what?", leave))
    assert result.outcome is Outcome.OUT_OF_STRIKES
    assert log.motions[-1] == "home"
    assert log.motions.count("strike") == 1
    assert grip_kept(bench.sim)


def test_a_person_at_the_terminal_takes_the_hammer_out(
    bench: Bench, log: Log, stopped: tuple[HammeringTask, HammerResult]
) -> None:
    task, result = stopped
    ended = after_stop(task, result, Person("t", "n"))
    assert ended is result
    assert bench.hand.opened == 1
    after_stop(task, result, Person("t", "y"))
    assert bench.hand.opened == 2
    assert log.motions == ["to the handover"]


class Visitor(People):
    """People who open the door when they come, and close it when they go."""

    def __init__(self, come: Callable[[], None], go: Callable[[], None]) -> None:
        super().__init__(on_release=go)
        self._come = come

    def request_handover(self, prompt: str, timeout: float) -> bool:
        self._come()
        return super().request_handover(prompt, timeout)


def visited(bench: Bench, log: Log, come: Callable[[], None], go: Callable[[], None]) -> HammeringTask:
    bench.people = Visitor(come, go)
    bench.person = bench.people
    return bench.blind_task(log)


def test_the_job_goes_on_once_a_person_has_looked_and_is_out_again(bench: Bench) -> None:
    log = Log()
    result = visited(bench, log, bench.arm.safeguard_stop, bench.arm.make_ready).run()
    assert bench.people.asked[:4] == ["handover", "release", "inspection", "release"]
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    assert result.stops == 0
    assert log.motions[-1] == "home"


@pytest.mark.nightly
def test_nothing_is_asked_of_who_stops_nothing(bench: Bench) -> None:
    log = Log()
    visited(bench, log, lambda: None, lambda: None).run()
    assert "inspection" not in bench.people.asked


@pytest.mark.nightly
@pytest.mark.parametrize("looks", [True, False])
def test_without_a_look_or_a_ready_robot_nothing_is_reset(bench: Bench, looks: bool) -> None:
    """And when it is ready in the end, the arm still learns what it carries."""
    log = Log()
    task = visited(bench, log, bench.arm.safeguard_stop, lambda: None if looks else bench.arm.make_ready())
    bench.people.inspects = looks
    result = task.run()
    assert result.outcome is Outcome.DEVICE_FAULT
    assert "safeguard stop" in result.reason
    assert log.motions == ["to the handover"]
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)
    assert task.resumable
    bench.arm.make_ready()
    result = task.resume(confirmed=True)
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    (strike,) = log.strikes
    assert strike.load.impulse > 0.0, "which takes the payload"


def test_somebody_who_is_inside_again_after_the_reset_keeps_the_arm_still(bench: Bench) -> None:
    log, releases = Log(), [0]

    def go() -> None:
        bench.arm.make_ready()
        releases[0] += 1
        bench.people.steps_back = releases[0] < 2

    result = visited(bench, log, bench.arm.safeguard_stop, go).run()
    assert releases == [2]
    assert result.outcome is Outcome.PERSON_NEAR
    assert log.motions == ["to the handover"]


@pytest.mark.nightly
def test_a_tool_that_is_taken_out_of_the_hand_before_the_handover(bench: Bench) -> None:
    """Who comes for it opens the door as well, and is seen out before the arm moves."""
    log = Log()

    class Takers(Visitor):
        def take_tool(self, prompt: str, timeout: float) -> bool:
            self._come()
            bench.arm._status = ArmStatus.READY  # they have closed the door behind them; the arm stays latched
            return super().take_tool(prompt, timeout)

    bench.people = Takers(bench.arm.safeguard_stop, bench.arm.make_ready)
    bench.person = bench.people
    bench.hand.close()  # around the tool that the bench begins with
    result = bench.blind_task(log).run()
    assert bench.people.asked[:4] == ["take", "inspection", "release", "handover"]
    assert log.motions[0] == "to the handover"
    assert result.stops == 0, result.reason


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


@pytest.mark.nightly
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


@pytest.mark.nightly
def test_a_strike_that_meets_something_too_early_is_looked_at_again_once(bench: Bench) -> None:
    """A plate lies over the nail: the arm brakes on it, goes up, looks again, and strikes once more without it."""
    config: StationConfig = replace(CONFIG, task=replace(CONFIG.task, max_strikes=2))
    client, nail = bench.sim.world.client, CONFIG.work.X_base_nail()[:3, 3]
    plates: list[int] = []

    def lay(_: Array = nail) -> None:
        shape = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=[0.03, 0.03, 0.005], physicsClientId=client)
        plates.append(pb.createMultiBody(0.0, shape, -1, [*nail[:2], nail[2] + 0.05], physicsClientId=client))

    def take_away() -> None:
        while plates:
            pb.removeBody(plates.pop(), physicsClientId=client)

    def go_up() -> None:
        kept.after.update(strike=lambda: kept.after.update(up=take_away))

    kept = Log(after={"to the run-up": lay, "up": go_up})
    try:
        result = bench.seeing_task(kept, config).run()
    finally:
        take_away()
    assert [m for m in kept.messages if "looking again" in m]
    assert len(result.estimates) == 2
    assert result.outcome is Outcome.OUT_OF_STRIKES
    assert [b.meeting for b in result.strikes] == [Meeting.EARLY, Meeting.EXPECTED]
    assert result.protrusion == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001)
    early = kept.reports[kept.motions.index("strike")]
    assert early.contact is not None
    # It braked: from the contact on not further than it takes.
    assert np.sum(early.stamps > early.contact.stamp) < 60
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)
