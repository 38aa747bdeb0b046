"""Variants of a job: the whole system, and what leaves out a part of it, to see what each part is worth."""

from __future__ import annotations

from enum import StrEnum


class Variant(StrEnum):
    """What a job does otherwise than the whole system."""

    FULL = "full"
    """Nothing: the whole system."""
    NO_CORRECTION = "no_correction"
    """It strikes with the nominal pose of the tool in the hand."""
    PERFECT_PERCEPTION = "perfect_perception"
    """It gets the tool's true pose instead of the camera's."""
    PAPER = "paper"
    """It estimates poses by the paper's estimator."""

    @property
    def corrects(self) -> bool:
        """Whether the estimated in-hand pose is used."""
        return self is not Variant.NO_CORRECTION

    @property
    def perfect(self) -> bool:
        """Whether poses come from the simulation's ground truth."""
        return self is Variant.PERFECT_PERCEPTION

    @property
    def ablation(self) -> str | None:
        """What perception leaves out or does instead; None for nothing."""
        whole = (Variant.FULL, Variant.NO_CORRECTION, Variant.PERFECT_PERCEPTION)
        return None if self in whole else self.value


SIMULATED_ONLY = {
    Variant.PERFECT_PERCEPTION: "it gets the tool's true pose, which only a simulation knows",
}
"""Variants that a robot cannot have, and why."""
