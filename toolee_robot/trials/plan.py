"""The plan of trials: which jobs, in which arms, with which errors. It is fixed before the first job begins."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from itertools import count, islice, product
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from toolee_robot.app.variant import SIMULATED_ONLY, Variant
from toolee_robot.depth_noise import SensorKind
from toolee_robot.runtime.yaml_files import read_record
from toolee_robot.station import ToolData
from toolee_robot.station.schema import STRICT, NotNegative, Positive

FIRST = frozenset({"name", "first_seed", "trials", "arms", "errors"})
"""Fields that count in the hash always; the others only where they say something, since published plans lack them."""
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
        tool: Name of the tool that a person hands over; None where the plan lists none.
        nail: Name of the nail; None where the plan lists none.
        wood: Name of the wood; None where the plan lists none.
        sensor: Kind of the simulated depth camera; None where the plan lists none.
    """

    arm: Variant
    seed: int
    tool: str | None = None
    nail: str | None = None
    wood: str | None = None
    sensor: SensorKind | None = None

    @property
    def put_there(self) -> tuple[str, ...]:
        """Names of tool, nail and wood; without those that the plan does not list."""
        return tuple(name for name in (self.tool, self.nail, self.wood) if name is not None)

    @property
    def conditions(self) -> str:
        """What differs between trials of a seed and an arm, in words; empty for nothing."""
        return ", ".join(self.put_there + (() if self.sensor is None else (self.sensor,)))


@dataclass(frozen=True)
class InSimulation:
    """Jobs as of `toolee sim hammer`."""

    __pydantic_config__ = STRICT
    config: str = ""
    """Changes of the simulated station, a YAML file; empty for none."""
    robot: Literal["UR10", "UR10e"] | None = None
    """Model of the arm; null for the station's."""


@dataclass(frozen=True)
class InRehearsal:
    """Jobs as of `toolee rehearse hammer`."""

    __pydantic_config__ = STRICT
    rehearse: Name
    """The station file."""
    real_time_factor: float | None = None
    """Rate of the station's time relative to wall-clock time; null for the arm's default."""
    profile: Literal["ideal", "harsh"] = "harsh"
    """How the controller follows, measures and stops."""


@dataclass(frozen=True)
class OnRobot:
    """Jobs as of `toolee run hammer`: a person is led through them, and the arm moves."""

    __pydantic_config__ = STRICT
    run: Name
    """The station file."""


Where = InSimulation | InRehearsal | OnRobot


@dataclass(frozen=True)
class TrialPlan:
    """A plan of paired trials: the same seeds in every arm."""

    __pydantic_config__ = STRICT
    name: Annotated[str, Field(min_length=1, max_length=80)]
    """Name, for the report's title."""
    first_seed: Annotated[int, Field(ge=0)]
    """The first seed; on a robot the number of the first repetition, such as 1."""
    trials: Annotated[int, Field(ge=1, le=100_000)]
    """Number of seeds, one after the other but for those `left_out`; on a robot of repetitions."""
    arms: Annotated[tuple[Variant, ...], Field(min_length=1)] = (Variant.FULL,)
    """Arms, compared with the first one."""
    errors: Literal["nominal", "exact"] | dict[str, NotNegative] = "nominal"
    """Errors of what the jobs are told (docs/concepts/cell_errors.md): `nominal`, `exact`, or sizes of some,
    the others nominal."""
    where: Where = field(default_factory=InSimulation)
    """In simulation `{config: YAML, robot: UR10e}`, with emulated devices `{rehearse: STATION, real_time_factor: 0.5}`,
    on a robot `{run: STATION}`."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Where the networks run."""
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
    left_out: tuple[Annotated[int, Field(ge=0)], ...] = ()
    """Seeds that are left out, such as those that draw a tool which an earlier seed of the plan has."""

    def __post_init__(self) -> None:
        if reason := next(self._problems(), None):
            raise ValueError(reason)

    def _problems(self) -> Iterator[str]:
        for name in ("arms", "sensors"):
            if len(set(getattr(self, name))) < len(getattr(self, name)):
                yield f"{name}: give each one once"
        if (Variant.PAPER in self.arms) != bool(self.paper_weights):
            yield (
                "paper_weights: the variant `paper`, and no other, needs the folder of a training of the paper's "
                "estimator. Without it `toolee sim hammer --variant paper` says how to train it"
            )
        if not self.led and self.seeds[-1] >= 2**31:
            yield f"first_seed, trials: seeds end at {2**31 - 1}"
        if never := sorted(set(self.left_out) - set(range(self.first_seed, self.seeds[-1]))):
            yield f"left_out: {', '.join(map(str, never))} are not in this plan"
        for what, names in (("tools", names_of(self.tools)), ("nails", names_of(self.nails)), ("woods", self.woods)):
            if len({slug(name) for name in names}) < len(names):
                yield f"{what}: give each a name of its own, which differs in letters or digits"
        if not isinstance(self.where, InSimulation) and (self.errors != "nominal" or self.sensors):
            yield "errors, sensors: leave them out, they are for simulations only"
        yield from self._of_a_person() if self.led else self._of_nobody()

    def _of_a_person(self) -> Iterator[str]:
        if isinstance(self.where, InSimulation):
            yield "attended: `where` names no station file, which says what a person hands over"
        for arm in self.arms:
            if reason := SIMULATED_ONLY.get(arm):
                yield f"arms: {arm} makes no sense on a robot: {reason}"

    def _of_nobody(self) -> Iterator[str]:
        if self.tools:
            yield "tools: leave them out in a simulation, where the seed chooses them"
        if self.instructions:
            yield "instructions: leave them out in a simulation, where nobody reads them"

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds, in their order; on a robot the numbers of the repetitions."""
        left_out = frozenset(self.left_out)
        return tuple(islice((seed for seed in count(self.first_seed) if seed not in left_out), self.trials))

    @property
    def on_robot(self) -> bool:
        """Whether the jobs move a real robot."""
        return isinstance(self.where, OnRobot)

    @property
    def led(self) -> bool:
        """Whether a person is led through the trials, one at a time."""
        return self.attended or self.on_robot

    @property
    def hash(self) -> str:
        """SHA-256 of what the plan says, whatever its file looks like."""
        plain, said = TrialPlan(self.name, self.first_seed, self.trials), asdict(self)
        later = {name for name in said if name not in FIRST and getattr(self, name) == getattr(plain, name)}
        of_first: dict[str, Any] = {"options": []}  # a field of the first plans, whose hashes are published
        said = of_first | {name: value for name, value in said.items() if name not in later}
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()

    def jobs(self) -> Iterator[Trial]:
        """The jobs as they are reported, all those of a seed one after the other.

        Yields:
            Each trial.
        """
        for seed in self.seeds:
            put_there = (names_of(self.tools), names_of(self.nails), tuple(self.woods))
            for tool, nail, wood in product(*(names or (None,) for names in put_there)):
                for sensor, arm in product(self.sensors or (None,), self.arms):
                    yield Trial(arm, seed, tool, nail, wood, sensor)

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
        """What `--setup` tells the job of a trial.

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
