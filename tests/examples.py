"""How much a test tries in every run, and how much only with --nightly."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import settings

QUICK, NIGHTLY = 40, 2000
"""Examples of a property test that does not say how many it wants."""
STATED_FOR = 100
"""Examples of the profile that the numbers of `examples` are stated for."""


def is_nightly() -> bool:
    """Whether the nightly profile is in force (`plugins/tiers.py` loads it)."""
    return settings().max_examples == NIGHTLY


def examples(count: int) -> settings:
    """Settings of a property test."""
    return settings(max_examples=max(count * settings().max_examples // STATED_FOR, 2), deadline=None)


def seldom(first: object, *others: object) -> list[Any]:
    """Cases of a parametrized test: the first is asked in every run, the others nightly."""
    rows = [case if isinstance(case, tuple) else (case,) for case in others]
    return [first, *(pytest.param(*row, marks=pytest.mark.nightly) for row in rows)]


timed = pytest.mark.parametrize("timed", seldom(False, True), ids=["untimed", "timed"])
"""A test that bounds durations nightly only: in every run a busy machine may be late."""
