"""A door that is wired to the robot's safeguard input, as it has to be: each handover stops the robot."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.rigs.job_rig import Bench, at_rest, grip_kept
from tests.rigs.people import People
from tests.tasks.bench import Log
from toolee_robot.hal import ArmStatus
from toolee_robot.tasks.common.outcome import Outcome
from toolee_robot.tasks.hammering.task import HammeringTask

pytestmark = pytest.mark.sim(seconds=20)


class Visitor(People):
    """People who open the door when they come, and close it when they go.

    Args:
        come: What their coming does.
        go: What their going does.
    """

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


def test_nothing_is_asked_of_who_stops_nothing(bench: Bench) -> None:
    log = Log()
    visited(bench, log, lambda: None, lambda: None).run()
    assert "inspection" not in bench.people.asked


@pytest.mark.parametrize("looks", [True, pytest.param(False, marks=pytest.mark.nightly)])
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
