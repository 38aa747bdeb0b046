"""A door that is wired to the robot's safeguard input, as it has to be: each handover stops the robot."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.tasks.bench import Log
from toolee_robot.faults.rigs.job_rig import Bench, at_rest, grip_kept
from toolee_robot.faults.rigs.people import People
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


def test_the_job_goes_on_once_the_door_is_closed(bench: Bench) -> None:
    log = Log()
    result = visited(bench, log, bench.arm.safeguard_stop, bench.arm.make_ready).run()
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    assert result.stops == 0
    assert log.motions[-1] == "home"


def test_a_safeguard_that_nobody_has_reset_is_waited_for_and_then_ends_the_job(bench: Bench) -> None:
    log = Log()
    begin = bench.sim.station.clock.now()
    result = visited(bench, log, bench.arm.safeguard_stop, lambda: None).run()
    assert result.outcome is Outcome.DEVICE_FAULT
    assert "safeguard stop" in result.reason
    (told,) = [message for message in log.messages if "safeguard" in message]
    assert "reset it, outside of its reach" in told
    assert bench.sim.station.clock.now() - begin > 2.0, "the handover's time"
    assert log.motions == ["to the handover"]
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


def test_whatever_else_has_stopped_the_robot_meanwhile_is_for_a_person_to_look_at(bench: Bench) -> None:
    """And when they have looked, the arm still learns what it carries."""
    log, arm = Log(), bench.arm

    def knocked() -> None:
        arm.make_ready()
        arm.protective_stop()

    task = visited(bench, log, arm.safeguard_stop, knocked)
    result = task.run()
    assert result.outcome is Outcome.DEVICE_FAULT
    assert log.motions == ["to the handover"]
    assert task.resumable
    arm.make_ready()
    bench.people.on_release = None
    result = task.resume(confirmed=True)
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    (strike,) = log.strikes
    assert strike.load.impulse > 0.0, "which takes the payload"


def test_a_tool_that_is_taken_out_of_the_hand_before_the_handover(bench: Bench) -> None:
    """Who comes for it opens the door as well, and steps back before the arm moves."""
    log = Log()

    class Takers(Visitor):
        def take_tool(self, prompt: str, timeout: float) -> bool:
            self._come()
            return super().take_tool(prompt, timeout)

    bench.people = Takers(bench.arm.safeguard_stop, bench.arm.make_ready)
    bench.person = bench.people
    bench.hand.close()  # around the tool that the bench begins with
    result = bench.blind_task(log).run()
    assert bench.people.asked[:3] == ["take", "release", "handover"]
    assert result.stops == 0
    assert log.motions[0] == "to the handover"
