"""Whether strikes still drive the nail: fast ones that stop are noticed at once, slow ones that go on are let go on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rigs.job_rig import CONFIG, Bench
from tests.tasks.bench import Log
from toolee_robot.tasks.common.outcome import Outcome
from toolee_robot.tasks.hammering.nail_forecast import FEWEST, MOST, NailStall

LEAST, LARGE = 0.0002, 0.00033
TOUCHES = 0.00027
"""Standard deviation of a measured height in the jobs of `docs/results/job.md` [m]."""


def test_two_strikes_that_do_nothing_after_fast_ones_tell_it() -> None:
    stall = NailStall(LEAST)
    stall.measured(2, 0.001, None)
    stall.measured(1, 0.0, 0.0009)
    assert not stall.over
    assert stall.suspected
    stall.measured(1, 0.0, 0.0009)
    assert stall.over
    assert str(stall) == "2 strikes together moved the head by 0.0 mm"


def test_nothing_was_expected_of_the_first_strikes() -> None:
    stall = NailStall(LEAST)
    stall.measured(FEWEST, 0.0001, None)
    assert stall.over


def test_many_slow_strikes_that_drive_the_nail_as_expected_are_no_stall() -> None:
    # Seed 7403 with an Inspire hand: 13 strikes drove it by 2.5 mm, and the job gave up at 2.7 mm.
    stall = NailStall(LEAST)
    stall.measured(13, 0.000195, 0.00022)
    assert not stall.suspected
    stall.measured(3, 0.000077, 0.00019)
    assert stall.suspected
    assert not stall.over
    stall.measured(2, 0.0003, 0.00019)
    assert (stall.strikes, stall.suspected) == (0, False)


def test_what_was_expected_before_a_stall_is_asked_for_while_it_lasts() -> None:
    stall = NailStall(LEAST)
    for expected in (0.0009, 0.0004, 0.0001, 0.0):
        stall.measured(1, 0.0, expected)
    assert (stall.strikes, stall.over) == (4, True)
    stall.again()
    stall.measured(2, 0.0, 0.0)
    assert stall.over


@given(st.floats(0.0, 0.002), st.integers(0, 2**32 - 1))
def test_a_nail_that_stands_still_is_noticed_within_a_bounded_number_of_strikes(expected: float, seed: int) -> None:
    stall, rng = NailStall(LEAST), np.random.default_rng(seed)
    for _ in range(MOST):
        stall.measured(1, -abs(rng.normal(0.0, 1e-5)), expected)
    assert stall.over


@pytest.mark.parametrize("pace", [0.0002, 0.0003, 0.0006, 0.001])
def test_a_nail_that_moves_as_expected_is_seldom_given_up(pace: float) -> None:
    """A job gives up at the second stall in a row."""
    stopped, jobs = 0, 500
    for seed in range(jobs):
        rng = np.random.default_rng(seed)
        stall, heights = NailStall(LEAST), rng.normal(0.0, TOUCHES, 40)
        doubted = False
        for number in range(1, 40):
            stall.measured(1, pace - (heights[number] - heights[number - 1]), pace)
            if not stall.over:
                doubted = doubted and stall.suspected
            elif doubted:
                stopped += 1
                break
            else:
                doubted = True
                stall.again()
    print(f"{pace * 1e3:.1f} mm a strike: {stopped} of {jobs} given up")
    assert stopped <= 0.03 * jobs


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
def test_a_nail_that_every_strike_moves_by_less_than_the_least_progress_is_driven_on(bench: Bench) -> None:
    strike = replace(CONFIG.strike, speed=0.45)
    config = replace(CONFIG, strike=strike, task=replace(CONFIG.task, max_strikes=16, min_progress=LARGE))
    result = bench.blind_task(Log(), config).run()
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    assert "raise task.max_strikes" in result.reason
    heights = [strike.protrusion for strike in result.strikes if strike.protrusion is not None]
    print([f"{height * 1e3:.2f}" for height in heights])
    assert (heights[1] - heights[-1]) / (16 - 3) < LARGE
