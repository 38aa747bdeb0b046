"""The kinds of tools, one `ToolSpec` each; tools by kind and seed, and the split into training and held-out instances.

A new kind is a `ToolKind`, a record in `TOOL_SPECS` and, unless a generator's parameters do, a shape in its generator
(`hammers`, `screwdrivers`, `wrenches`).
"""

from __future__ import annotations

import atexit
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import count, islice
from typing import Literal

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.tools.hammers import (
    BALL_PEEN_HAMMER,
    CLAW_HAMMER,
    CLUB_HAMMER,
    CROSS_PEEN_HAMMER,
    MALLET,
    make_hammer,
)
from toolee_robot.tools.model import Family, Tool, ToolKind
from toolee_robot.tools.screwdrivers import make_screwdriver, nut_tip, phillips_tip, slotted_tip
from toolee_robot.tools.wrenches import make_wrench

SWUNG_MASS = (0.4, 1.05)
"""Mass [kg] of the hammers that one hand swings."""


@dataclass(frozen=True)
class ToolSpec:
    """What is known of a kind of tool beforehand."""

    kind: ToolKind
    """The kind."""
    number: int
    """Counts in the seeds of its random numbers and in the object ids of data sets: it stays as it is, and a new kind
    gets the next one."""
    family: Family
    """The family, whose generator makes it."""
    end_effectors: tuple[Category, ...]
    """The categories of its end effectors, the working end first. A tool may have two ends of one category."""
    make: Callable[[ToolKind, int, np.random.Generator], Tool]
    """Its generator, called with the kind, the seed and the tool's own random numbers."""
    drives_nails: bool = False
    """Whether the simulated person hands it over to drive a nail, and the doctor plans strikes with it."""
    draw_weight: float = 1.0
    """How often data sets draw it, next to the other kinds of its family."""
    training_share: int = 1
    """So many times as many of its tools are sampled for training."""


TOOL_SPECS: dict[ToolKind, ToolSpec] = {
    spec.kind: spec
    for spec in (
        # The only kind with a claw: drawn more often, that the claws are not few.
        ToolSpec(
            ToolKind.CLAW_HAMMER,
            0,
            Family.HAMMERS,
            (Category.HAMMER_HEAD, Category.HAMMER_GRIP),
            partial(make_hammer, CLAW_HAMMER),
            drives_nails=True,
            draw_weight=6.0,
            training_share=2,
        ),
        ToolSpec(
            ToolKind.BALL_PEEN_HAMMER,
            1,
            Family.HAMMERS,
            (Category.HAMMER_HEAD,),
            partial(make_hammer, BALL_PEEN_HAMMER),
            drives_nails=True,
        ),
        ToolSpec(
            ToolKind.CROSS_PEEN_HAMMER,
            2,
            Family.HAMMERS,
            (Category.HAMMER_HEAD,),
            partial(make_hammer, CROSS_PEEN_HAMMER),
            drives_nails=True,
        ),
        ToolSpec(
            ToolKind.CLUB_HAMMER,
            3,
            Family.HAMMERS,
            (Category.HAMMER_HEAD,),
            partial(make_hammer, CLUB_HAMMER),
            drives_nails=True,
        ),
        ToolSpec(ToolKind.MALLET, 4, Family.HAMMERS, (Category.HAMMER_HEAD,), partial(make_hammer, MALLET)),
        ToolSpec(
            ToolKind.SLOTTED_SCREWDRIVER,
            5,
            Family.SCREWDRIVERS,
            (Category.SCREWDRIVER_HEAD,),
            partial(make_screwdriver, slotted_tip),
        ),
        ToolSpec(
            ToolKind.PHILLIPS_SCREWDRIVER,
            6,
            Family.SCREWDRIVERS,
            (Category.SCREWDRIVER_HEAD,),
            partial(make_screwdriver, phillips_tip),
        ),
        ToolSpec(
            ToolKind.NUT_DRIVER,
            7,
            Family.SCREWDRIVERS,
            (Category.SCREWDRIVER_HEAD,),
            partial(make_screwdriver, nut_tip),
        ),
        ToolSpec(ToolKind.OPEN_END_WRENCH, 8, Family.WRENCHES, (Category.WRENCH_HEAD,), make_wrench),
        ToolSpec(ToolKind.COMBINATION_WRENCH, 9, Family.WRENCHES, (Category.WRENCH_HEAD,), make_wrench),
        ToolSpec(ToolKind.ADJUSTABLE_WRENCH, 10, Family.WRENCHES, (Category.WRENCH_HEAD,), make_wrench),
        ToolSpec(ToolKind.BOX_WRENCH, 11, Family.WRENCHES, (Category.WRENCH_HEAD,), make_wrench),
        ToolSpec(ToolKind.SOCKET_WRENCH, 12, Family.WRENCHES, (Category.WRENCH_HEAD,), make_wrench),
    )
}
"""All kinds, in the order of their numbers."""

NAIL_DRIVERS: tuple[ToolKind, ...] = tuple(kind for kind, spec in TOOL_SPECS.items() if spec.drives_nails)
"""Kinds that drive a nail: hammers with a hard face."""


def kinds_of(family: Family) -> tuple[ToolKind, ...]:
    """The kinds of a family."""
    return tuple(kind for kind, spec in TOOL_SPECS.items() if spec.family is family)


@lru_cache(maxsize=512)
def make_tool(kind: ToolKind, seed: int) -> Tool:
    """The tool of that kind and seed (0 or more), always the same one. Tools are shared: do not change their meshes."""
    if seed < 0:
        raise UserError(f"the seed must be 0 or more, got {seed}")
    spec = TOOL_SPECS[ToolKind(kind)]
    return spec.make(spec.kind, seed, np.random.default_rng([spec.number, seed]))


# Before the interpreter takes manifold's module down, which would count the tools' solids as leaked.
atexit.register(make_tool.cache_clear)


def split(seed: int) -> Literal["train", "test"]:
    """Every fifth seed, of every kind, is held out from training."""
    return "test" if seed % 5 == 4 else "train"


def train_seeds(n: int) -> tuple[int, ...]:
    """The first n seeds for training."""
    return tuple(islice((s for s in count() if split(s) == "train"), n))


def test_seeds(n: int) -> tuple[int, ...]:
    """The first n held-out seeds."""
    return tuple(islice((s for s in count() if split(s) == "test"), n))


test_seeds.__test__ = False  # type: ignore[attr-defined]  # pytest would collect it
