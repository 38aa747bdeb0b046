"""The bench that the fault matrix works on is the tests', too."""

from __future__ import annotations

from toolee_robot.faults.job_bench import (
    CONFIG,
    HOME,
    Bench,
    ClosedHand,
    Log,
    NoPerception,
    People,
    at_rest,
    grip_kept,
    is_home,
)

__all__ = ["CONFIG", "HOME", "Bench", "ClosedHand", "Log", "NoPerception", "People", "at_rest", "grip_kept", "is_home"]
