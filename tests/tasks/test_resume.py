"""A job that was stopped with the hammer in the hand: it goes on after a person, or the person takes the hammer out."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.errors import raises
from tests.rigs.job_rig import Bench, at_rest, grip_kept
from tests.tasks.bench import Log, soon
from toolee_robot.app.job import after_stop
from toolee_robot.app.observer import JobObserver
from toolee_robot.control import StrikePlan
from toolee_robot.errors import DeviceError, NotReadyError
from toolee_robot.tasks.common.outcome import MAX_STOPS, RESUME, TAKE_OUT, HammerResult, Outcome, Stage
from toolee_robot.tasks.common.watches import MAX_DOUBTS
from toolee_robot.tasks.hammering.task import HammeringTask

pytestmark = pytest.mark.sim(seconds=60)


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
