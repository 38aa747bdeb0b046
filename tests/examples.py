"""How many examples the property tests draw: few in every run, more with --nightly."""

from __future__ import annotations

from hypothesis import settings

QUICK, NIGHTLY = 100, 2000
"""Examples of a test that does not say how many it wants."""


def is_nightly() -> bool:
    """Whether the nightly profile is in force (`plugins/tiers.py` loads it)."""
    return settings().max_examples == NIGHTLY


def examples(count: int) -> settings:
    """Settings of a property test."""
    return settings(max_examples=count * settings().max_examples // QUICK, deadline=None)
