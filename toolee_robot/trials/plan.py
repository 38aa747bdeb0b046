"""The plan of trials: which jobs, in which arms, with which errors. It is fixed before the first job begins."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from itertools import count, islice, product
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from toolee_robot.runtime.yaml_files import read_record
from toolee_robot.sensor_kinds import SensorKind
from toolee_robot.station import ToolData
from toolee_robot.station.values import STRICT, Count, NotNegative, Positive
from toolee_robot.trials.attended_plan import option, why_not_attended


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
    PAPER = "paper"
    """They estimate poses by the paper's estimator."""
    LEARNT_GRASP = "learnt_grasp"
    """They believe the nominal pose of the tool in the hand, moved as the hand moved earlier tools in the mean."""

    @property
    def options(self) -> tuple[str, ...]:
        """Options of `toolee hammer` of this arm."""
        if self is Arm.FULL:
            return ()
        if self in (Arm.NO_CORRECTION, Arm.PERFECT_PERCEPTION):
            return ("--" + self.value.replace("_", "-"),)
        return ("--ablation", self.value)


OWN = frozenset(
    {"--seed", "--json", "--out", "--errors", "--exact", "--ablation", "--no-correction"}
    | {"--setup", "--paper-weights", "--learnt-from", "--sensor"}
)
"""Options of `toolee hammer` that the plan's other fields say."""
LATER = frozenset(
    {"sweep", "attended", "instructions", "tools", "nails", "woods", "sensors", "paper_weights"}
    | {"learnt_from", "left_out"}
)
"""Fields that count in the hash only where they say something: plans that were begun before have none of them."""
Name = Annotated[str, Field(min_length=1, max_length=60)]


@dataclass(frozen=True)
class NailSizes:
    """A nail of a plan. No field has a default: every trial states its nail and its pilot hole."""

    __pydantic_config__ = STRICT
    name: Name
    """What it is called in the report and at the terminal, such as `3.1 x 65`."""
    diameter: Positive
    """Diameter of its shank [m]."""
    length: Positive
    """Length of its shank [m]."""
    head_diameter: Positive
    """Diameter of its head [m]."""
    protrusion: Positive
    """Height of the top of its head over the wood before the first strike [m]."""
    pilot_hole_diameter: NotNegative
    """Diameter of its predrilled hole, 0 for none [m]."""


@dataclass(frozen=True)
class Trial:
    """One job of a plan.

    Attributes:
        arm: Its arm.
        seed: Its seed: hammer, grasp, room and errors, the same in every arm. On a robot, where a seed draws nothing,
            the number of the repetition.
        error: The error that has a size of its own; None for none.
        size: That size, in the error's unit.
        tool: Name of the tool that a person hands over; None where the plan lists none.
        nail: Name of the nail; None where the plan lists none.
        wood: Name of the wood; None where the plan lists none.
        sensor: Kind of the simulated depth camera; None where the plan lists none.
    """

    arm: Arm
    seed: int
    error: str | None = None
    size: float | None = None
    tool: str | None = None
    nail: str | None = None
    wood: str | None = None
    sensor: str | None = None

    @property
    def put_there(self) -> str:
        """Tool, nail and wood, as the name of a file; empty where the plan lists none."""
        return "-".join(slug(name) for name in (self.tool, self.nail, self.wood) if name is not None)

    @property
    def variation(self) -> str:
        """What differs between trials of a seed and an arm, as the name of a folder; empty for nothing."""
        error = "" if self.error is None else f"{self.error}-{self.size:g}"
        return "-".join(part for part in (error, self.put_there, self.sensor) if part)

    @property
    def conditions(self) -> str:
        """The same in words."""
        error = None if self.error is None else f"{self.error} {self.size:g}"
        return ", ".join(part for part in (self.tool, self.nail, self.wood, self.sensor, error) if part)


@dataclass(frozen=True)
class TrialPlan:
    """A plan of paired trials: the same seeds in every arm."""

    __pydantic_config__ = STRICT
    name: Annotated[str, Field(min_length=1, max_length=80)]
    """Name, for the report's title."""
    first_seed: Annotated[int, Field(ge=0)]
    """The first seed; on a robot the number of the first repetition, such as 1."""
    trials: Count
    """Number of seeds, one after the other but for those `left_out`; on a robot of repetitions."""
    arms: Annotated[tuple[Arm, ...], Field(min_length=1)] = (Arm.FULL,)
    """Arms, compared with the first one."""
    errors: Literal["nominal", "exact"] | dict[str, NotNegative] = "nominal"
    """Errors of what the jobs are told (docs/concepts/cell_errors.md): `nominal`, `exact`, or sizes of some,
    the others nominal."""
    options: tuple[str, ...] = ()
    """Further options of `toolee hammer`, such as `--station lab.yaml`, `--rehearse`."""
    sweep: dict[str, Annotated[tuple[NotNegative, ...], Field(min_length=1)]] = field(default_factory=dict)
    """Sizes of errors, each of which every seed and arm gets instead of the one in `errors`, one error at a time; once
    they get none."""
    attended: bool = False
    """Whether a person is led through a rehearsal as through trials on a robot, which always are."""
    instructions: Annotated[str, Field(max_length=2000)] = ""
    """What the person reads before each trial, beside its tool, nail and wood."""
    tools: tuple[ToolData | Name, ...] = ()
    """Tools that a person hands over, each of which every repetition and arm gets: the name of the station file's
    `tool`, or data as there. None: the station file's."""
    nails: tuple[NailSizes | Name, ...] = ()
    """Nails, each of which every seed and arm gets: the name of one of the station's, or sizes. None: the station's."""
    woods: dict[Name, Annotated[float, Field(gt=0, lt=1.5)]] = field(default_factory=dict)
    """Woods, each of which every seed and arm gets: names, and their specific gravity. None: the station's."""
    sensors: tuple[SensorKind, ...] = ()
    """Kinds of the simulated depth camera, each of which every seed and arm gets. None: the nominal time-of-flight
    camera."""
    paper_weights: Annotated[str, Field(max_length=1000)] = ""
    """Folder of a training of the paper's estimator, for the arm `paper`, from where the trials are run."""
    learnt_from: Annotated[str, Field(max_length=1000)] = ""
    """Folder of earlier jobs with the same hand, for the arm `learnt_grasp`, from where the trials are run."""
    left_out: tuple[Annotated[int, Field(ge=0)], ...] = ()
    """Seeds that are left out, such as those that draw a tool which an earlier seed of the plan has."""

    def __post_init__(self) -> None:
        if self.sweep and self.errors == "exact":
            raise ValueError("sweep: the errors that are not swept are nominal, or sizes; not exact")
        if len(set(self.arms)) < len(self.arms):
            raise ValueError("arms: each one once")
        if (Arm.PAPER in self.arms) != bool(self.paper_weights):
            raise ValueError(
                "paper_weights: the arm `paper` needs the folder of a training of the paper's estimator, and no other "
                "arm does; without them `toolee hammer --ablation paper` tells how it is trained"
            )
        if (Arm.LEARNT_GRASP in self.arms) != bool(self.learnt_from):
            raise ValueError(
                "learnt_from: the arm `learnt_grasp` needs the folder of earlier jobs with the same hand, and no other "
                "arm does"
            )
        if never := sorted(set(self.left_out) - set(range(self.first_seed, self.seeds[-1]))):
            raise ValueError(f"left_out: {', '.join(map(str, never))} would not come in this plan")
        given = {option.split("=")[0].replace("_", "-") for option in self.options if option.startswith("--")}
        if wrong := sorted(given & (OWN | ({"--nail"} if self.nails else set()))):
            raise ValueError(f"options: {', '.join(wrong)} is said by the plan's other fields")
        for what, names in (("tools", names_of(self.tools)), ("nails", names_of(self.nails)), ("woods", self.woods)):
            if len({slug(name) for name in names}) < len(names):
                raise ValueError(f"{what}: give each a name of its own, which differs in letters or digits")
        if self.led and (reason := why_not_attended(self)):
            raise ValueError(reason)
        if not self.led and self.tools:
            raise ValueError(
                "tools: in a simulation the tool is drawn from the seed; a person hands over those of a plan on a robot"
            )
        if self.sensors and option(self.options, "--station") is not None:
            raise ValueError("sensors: they are drawn in a simulation; a station has its own camera, so leave them out")
        if self.sensors and option(self.options, "--arm") == "ur-rtde":
            raise ValueError("sensors: they cannot be tried with `--arm ur-rtde` yet: leave one of them out")
        if len(set(self.sensors)) < len(self.sensors):
            raise ValueError("sensors: each one once")
        if not self.led and self.instructions:
            raise ValueError("instructions: nobody reads them in a simulation")

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds, in their order; on a robot the numbers of the repetitions."""
        left_out = frozenset(self.left_out)
        return tuple(islice((seed for seed in count(self.first_seed) if seed not in left_out), self.trials))

    @property
    def on_robot(self) -> bool:
        """Whether the jobs move a real robot."""
        return option(self.options, "--station") is not None and "--rehearse" not in self.options

    @property
    def led(self) -> bool:
        """Whether a person is led through the trials, one at a time."""
        return self.attended or self.on_robot

    @property
    def hash(self) -> str:
        """SHA-256 of what the plan says, whatever its file looks like."""
        said = {name: value for name, value in asdict(self).items() if name not in LATER or value}
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()

    def jobs(self) -> Iterator[Trial]:
        """The jobs as they are reported, all those of a seed one after the other.

        Yields:
            Each trial.
        """
        swept: list[tuple[str | None, float | None]]
        swept = [(None, None), *((error, size) for error, sizes in self.sweep.items() for size in sizes)]
        for seed in self.seeds:
            for error, size in swept:
                for tool, nail, wood, sensor in self._conditions():
                    for arm in self.arms:
                        yield Trial(arm, seed, error, size, tool, nail, wood, sensor)

    def _conditions(self) -> Iterator[tuple[str | None, ...]]:
        none: tuple[str | None, ...] = (None,)
        lists = (names_of(self.tools), names_of(self.nails), tuple(self.woods), self.sensors)
        return product(*(names or none for names in lists))

    def order(self) -> list[Trial]:
        """The jobs in the order in which they are run.

        A person's are blocks of one tool, nail, wood and repetition, with all arms one after the other: the blocks in
        an order drawn from the plan's hash, and the arms in each block, too (a randomised complete block design), so
        that neither a drift of the station nor the person's practice favours an arm.

        Returns:
            The trials; simulated ones as in `jobs`.
        """
        if not self.led:
            return list(self.jobs())
        # Sorted by digests: an order that no version of a random generator changes.
        return sorted(self.jobs(), key=lambda trial: (self._drawn(trial, arm=False), self._drawn(trial, arm=True)))

    def _drawn(self, trial: Trial, *, arm: bool) -> str:
        block = [trial.seed, trial.tool, trial.nail, trial.wood, *([trial.arm] if arm else [])]
        return hashlib.sha256(json.dumps([self.hash, *block]).encode()).hexdigest()

    def setup(self, trial: Trial) -> dict[str, Any]:
        """What `toolee hammer --setup` is told of a trial.

        Args:
            trial: The trial.

        Returns:
            Sections `tool` and `work`, for YAML; without what is the station's.
        """
        tools = [tool for tool in self.tools if isinstance(tool, ToolData) and tool.name == trial.tool]
        nails = [nail for nail in self.nails if isinstance(nail, NailSizes) and nail.name == trial.nail]
        work = {"wood_specific_gravity": self.woods[trial.wood]} if trial.wood is not None else {}
        for nail in nails:
            sizes = {name: value for name, value in asdict(nail).items() if name != "name"}
            work |= {name if name == "pilot_hole_diameter" else f"nail_{name}": value for name, value in sizes.items()}
        tool = {"tool": json.loads(json.dumps(asdict(tools[0])))} if tools else {}
        return tool | ({"work": work} if work else {})


def names_of(listed: tuple[Any, ...]) -> tuple[str, ...]:
    """Names of tools or nails of a plan.

    Args:
        listed: Names, or records with one.

    Returns:
        The names.
    """
    return tuple(one if isinstance(one, str) else one.name for one in listed)


def slug(name: str) -> str:
    """A name as part of a file's.

    Args:
        name: The name.

    Returns:
        Its letters, digits and dots, with `_` for all else.
    """
    return re.sub(r"[^\w.]+", "_", name)


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
