"""Intervals and tests agree with values that others have computed."""

from __future__ import annotations

import pytest

from toolee_robot.app.variant import Variant
from toolee_robot.trials import Record, Trial
from toolee_robot.trials.statistics import by_size, compare, median, share


def records(successes: str, arm: Variant = Variant.FULL) -> list[Record]:
    return [
        Record(Trial(arm, i), {"success": c == "x", "errors": {"camera_mm": float(i)}, "strikes": i or None}, ())
        for i, c in enumerate(successes)
    ]


@pytest.mark.parametrize(
    ("hits", "of", "low", "high"),
    [(100, 100, 0.9630, 1.0), (0, 20, 0.0, 0.1611), (81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605)],
)
def test_intervals_are_wilsons(hits: int, of: int, low: float, high: float) -> None:
    """The last two from Newcombe, "Two-sided confidence intervals for the single proportion", 1998, table I."""
    found = share([i < hits for i in range(of)])
    assert [found.low, found.high] == pytest.approx([low, high], abs=1e-4)


def test_pairs_are_compared_by_the_exact_test() -> None:
    """Ten pairs differ, one of them for the better: 2 (1 + 10) / 2^10."""
    found = compare(records("x" + "." * 9 + "xx", Variant.ONE_VIEW), records("." + "x" * 9 + "xx"))
    assert (found.pairs, found.better, found.worse) == (12, 1, 9)
    assert found.p == pytest.approx(22 / 1024)
    assert compare(records("xx"), records("xx")).p == 1.0


def test_only_seeds_that_both_have_are_pairs() -> None:
    assert compare(records("x.x"), records("xxxxxx")).pairs == 3


def test_trials_are_sorted_by_the_size_of_an_error() -> None:
    bins = by_size(records("xxxxxx..x..."), "camera_mm")
    assert [(b.low, b.high, b.share.hits) for b in bins] == [(0, 2, 3), (3, 5, 3), (6, 8, 1), (9, 11, 0)]
    assert by_size(records("xx"), "camera_mm") == []
    assert by_size(records("xxxxxxxx"), "nail_mm") == []


def test_a_median_leaves_out_what_is_not_known() -> None:
    assert median(records("xxxx"), "strikes") == 2.0
    assert median(records("x"), "strikes") is None
