"""A nail that leans as it was set, or that strikes have bent, is seen by the camera and struck no further."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.rigs.job_rig import CONFIG, Bench, at_rest, grip_kept
from tests.tasks.bench import Log, is_home
from toolee_robot.perception.nail.sight import HeadOffset
from toolee_robot.tasks.common.outcome import Outcome, Strike
from toolee_robot.tasks.hammering.nail_driving import STRIKES_BEFORE_SECOND_LOOK
from toolee_robot.tasks.hammering.nail_watch import is_bent

pytestmark = pytest.mark.sim(seconds=30)

USUAL = CONFIG.task.strikes_between_looks
LONG = replace(CONFIG, task=replace(CONFIG.task, max_strikes=20))


def test_a_nail_that_leans_as_it_was_set_is_not_struck(bench: Bench) -> None:
    nail = bench.sim.world.nail
    nail.place(nail.spec.protrusion, (0.0, np.deg2rad(25)))
    log = Log()
    result = bench.seeing_task(log).run()
    assert result.outcome is Outcome.BENT
    assert "the camera sees the nail lean" in result.reason
    assert not result.strikes
    assert is_home(bench.sim)
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


def test_a_lab_whose_camera_sees_it_wrongly_leaves_it_out(bench: Bench) -> None:
    nail = bench.sim.world.nail
    nail.place(nail.spec.protrusion, (0.0, np.deg2rad(25)))
    config = replace(CONFIG, task=replace(CONFIG.task, watch_nail=False))
    log = Log()
    result = bench.seeing_task(log, config).run()
    assert "the camera sees" not in result.reason
    assert "touch the nail" in log.motions


class Bending(Log):
    """Pushes the nail's head aside after the last strike before a look at the tool."""

    def __init__(self, bench: Bench, aside: float) -> None:
        super().__init__()
        self._bench, self._aside = bench, aside

    def strike(self, strike: Strike) -> None:
        super().strike(strike)
        if len(self.strikes) == USUAL:
            nail = self._bench.sim.world.nail
            nail.place(nail.protrusion, (float(np.arcsin(self._aside / nail.protrusion)), 0.0))


@pytest.mark.parametrize(("aside", "bent"), [pytest.param(0.0, False, marks=pytest.mark.nightly), (0.004, True)])
def test_a_nail_that_strikes_have_bent_is_seen_and_struck_no_further_once_it_is_seen_again(
    bench: Bench, aside: float, bent: bool
) -> None:
    log = Bending(bench, aside)
    result = bench.seeing_task(log, LONG).run()
    if not bent:
        assert result.outcome is Outcome.FLUSH, result.reason
        assert not any("does not see the nail" in message for message in log.messages)
        return
    assert result.outcome is Outcome.BENT
    assert "the camera sees the nail's head" in result.reason
    assert "for the second time" in result.reason
    assert any("it may be bent" in message for message in log.messages), "it is told at the first look"
    assert len(result.strikes) == USUAL + STRIKES_BEFORE_SECOND_LOOK
    assert is_home(bench.sim)
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


def test_a_head_that_is_seen_aside_twice_but_not_on_the_same_side_is_none() -> None:
    def seen(angle: float, distance: float = 0.004) -> HeadOffset:
        return HeadOffset(distance * np.array([np.cos(angle), np.sin(angle)]), 0.0005**2 * np.eye(2))

    assert is_bent(seen(0.3), seen(1.0))
    assert not is_bent(seen(0.3), seen(2.5))
    assert not is_bent(seen(0.3), seen(0.3, distance=0.002)), "it is not aside at the next one"
    assert not is_bent(seen(0.3), None)
    assert not is_bent(None, seen(0.3))
