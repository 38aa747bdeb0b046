"""The plan of trials: which jobs, in which arms, with which errors. It is fixed before the first job begins."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from toolee_robot.config.values import STRICT, Count, NotNegative
from toolee_robot.runtime.yaml_files import read_record


class Arm(StrEnum):
    """What the jobs of an arm do otherwise than the whole system."""

    FULL = "full"
    """Nothing: the whole system."""
    NO_CORRECTION = "no_correction"
    """They strike with the nominal pose of the tool in the hand."""
    PERFECT_PERCEPTION = "perfect_perception"
    """They get the tool's true pose instead of the camera's."""
    POSITION_ONLY = "position_only"
    """They believe the estimated place of the face, and its nominal direction."""
    NORMAL_ONLY = "normal_only"
    """They believe the estimated direction of the face, and its nominal place."""
    ONE_VIEW = "one_view"
    """They look once where the whole system looks from several views."""
    MASK_CENTROID = "mask_centroid"
    """They take the mask's centroid for the face's place, and its nominal direction."""
    ICP = "icp"
    """They register the tool's own shape, which they are told, to the cloud (iterative closest point)."""

    @property
    def options(self) -> tuple[str, ...]:
        """Options of `toolee hammer` of this arm."""
        if self is Arm.FULL:
            return ()
        if self in (Arm.NO_CORRECTION, Arm.PERFECT_PERCEPTION):
            return ("--" + self.value.replace("_", "-"),)
        return ("--ablation", self.value)


OWN = frozenset({"--seed", "--json", "--out", "--errors", "--exact", "--ablation", "--no-correction"})
"""Options of `toolee hammer` that the plan's other fields say."""


@dataclass(frozen=True)
class Trial:
    """One job of a plan.

    Attributes:
        arm: Its arm.
        seed: Its seed: hammer, grasp, room and errors, the same in every arm.
        error: The error that has a size of its own; None for none.
        size: That size, in the error's unit.
    """

    arm: Arm
    seed: int
    error: str | None = None
    size: float | None = None

    @property
    def variation(self) -> str:
        """The error and its size, as the name of a file; empty for none."""
        return "" if self.error is None else f"{self.error}-{self.size:g}"


@dataclass(frozen=True)
class TrialPlan:
    """A plan of paired trials: the same seeds in every arm."""

    __pydantic_config__ = STRICT
    name: Annotated[str, Field(min_length=1, max_length=80)]
    """Name, for the report's title."""
    first_seed: Annotated[int, Field(ge=0)]
    """The first seed."""
    trials: Count
    """Number of seeds, one after the other."""
    arms: Annotated[tuple[Arm, ...], Field(min_length=1)] = (Arm.FULL,)
    """Arms, compared with the first one."""
    errors: Literal["nominal", "exact"] | dict[str, NotNegative] = "nominal"
    """Errors of what the jobs are told (docs/concepts/cell_errors.md): `nominal`, `exact`, or sizes of some,
    the others nominal."""
    options: tuple[str, ...] = ()
    """Further options of `toolee hammer`, such as `--station lab.yaml`, `--rehearse`."""
    sweep: dict[str, Annotated[tuple[NotNegative, ...], Field(min_length=1)]] = field(default_factory=dict)
    """Sizes of errors, each of which every seed and arm gets instead of the one in `errors`, one error at a time."""

    def __post_init__(self) -> None:
        if self.sweep and self.errors == "exact":
            raise ValueError("sweep: the errors that are not swept are nominal, or sizes; not exact")
        if len(set(self.arms)) < len(self.arms):
            raise ValueError("arms: each one once")
        given = {option.split("=")[0].replace("_", "-") for option in self.options if option.startswith("--")}
        if wrong := sorted(given & OWN):
            raise ValueError(f"options: {', '.join(wrong)} is said by the plan's other fields")

    @property
    def hash(self) -> str:
        """SHA-256 of what the plan says, whatever its file looks like."""
        said = {name: value for name, value in asdict(self).items() if name != "sweep" or value}
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()

    def jobs(self) -> Iterator[Trial]:
        """The jobs in their order, all those of a seed one after the other.

        Yields:
            Each trial.
        """
        swept: list[tuple[str | None, float | None]]
        swept = [(error, size) for error, sizes in self.sweep.items() for size in sizes]
        for seed in range(self.first_seed, self.first_seed + self.trials):
            for error, size in swept or [(None, None)]:
                for arm in self.arms:
                    yield Trial(arm, seed, error, size)


def load_plan(path: Path) -> TrialPlan:
    """Read a plan.

    Args:
        path: YAML file with the fields of `TrialPlan`.

    Returns:
        The plan.

    Raises:
        ConfigError: The file cannot be read, or is no plan; the message names every field that is wrong.
    """
    return read_record(path, TrialPlan, "trial plan")
