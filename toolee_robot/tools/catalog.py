"""Catalog of tool kinds (`ToolSpec`), tools by kind and seed, and the split into training and held-out instances.

A new kind needs a `ToolKind`, a record in `TOOL_SPECS` and, if the parameters of an existing generator (`hammers`,
`screwdrivers`, `wrenches`) do not cover it, a shape in that generator.
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
    HANGING_CLAW_HAMMER,
    MALLET,
    MEAT_TENDERISER,
    SLEDGE_HAMMER,
    WOODEN_MALLET,
    make_hammer,
)
from toolee_robot.tools.model import Family, Tool, ToolKind
from toolee_robot.tools.pipe_wrenches import make_monkey_wrench, make_pipe_wrench
from toolee_robot.tools.screwdrivers import (
    common_shaft,
    long_shaft,
    make_screwdriver,
    nut_tip,
    phillips_tip,
    slotted_tip,
)
from toolee_robot.tools.wrenches import make_wrench

SWUNG_MASS = (0.4, 1.05)
"""Range of the mass [kg] of hammers for one-handed swinging."""


@dataclass(frozen=True)
class ToolSpec:
    """Static properties of a kind of tool."""

    kind: ToolKind
    """The kind."""
    number: int
    """Unique number of the kind. It enters the random seeds and the object ids of data sets: never change or reuse it;
    a new kind takes the next free number, from 100 on."""
    family: Family
    """The family; kinds of one family share a generator."""
    end_effectors: tuple[Category, ...]
    """Distinct categories of its end effectors, the working end first. A tool may have two ends of one category."""
    make: Callable[[ToolKind, int, np.random.Generator], Tool]
    """Generator, called with the kind, the seed and the random generator of the tool."""
    drives_nails: bool = False
    """Whether it can drive a nail: used by the simulated person's hand-overs and the strike checks of the doctor."""
    draw_weight: float = 1.0
    """Relative sampling weight in data sets, among the kinds of its family."""
    training_share: int = 1
    """Factor on the number of its tools that are sampled for training."""


TOOL_SPECS: dict[ToolKind, ToolSpec] = {
    spec.kind: spec
    for spec in (
        # Claws are the class with the fewest examples: a higher weight balances the classes.
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
            partial(make_screwdriver, slotted_tip, common_shaft),
        ),
        ToolSpec(
            ToolKind.PHILLIPS_SCREWDRIVER,
            6,
            Family.SCREWDRIVERS,
            (Category.SCREWDRIVER_HEAD,),
            partial(make_screwdriver, phillips_tip, common_shaft),
        ),
        ToolSpec(
            ToolKind.NUT_DRIVER,
            7,
            Family.SCREWDRIVERS,
            (Category.SCREWDRIVER_HEAD,),
            partial(make_screwdriver, nut_tip, common_shaft),
        ),
        ToolSpec(ToolKind.OPEN_END_WRENCH, 8, Family.WRENCHES, (Category.WRENCH_HEAD,), make_wrench),
        ToolSpec(ToolKind.COMBINATION_WRENCH, 9, Family.WRENCHES, (Category.WRENCH_HEAD,), make_wrench),
        ToolSpec(ToolKind.ADJUSTABLE_WRENCH, 10, Family.WRENCHES, (Category.WRENCH_HEAD,), make_wrench),
        ToolSpec(ToolKind.BOX_WRENCH, 11, Family.WRENCHES, (Category.WRENCH_HEAD,), make_wrench),
        ToolSpec(ToolKind.SOCKET_WRENCH, 12, Family.WRENCHES, (Category.WRENCH_HEAD,), make_wrench),
        # 13 to 99 stay free: data sets number custom tools from where kind 13 would begin (`dataset.catalogue`).
        # A third of each family's draws are of the kinds below, which drive no nails, so that jobs keep their hammers.
        ToolSpec(
            ToolKind.HANGING_CLAW_HAMMER,
            100,
            Family.HAMMERS,
            (Category.HAMMER_HEAD, Category.HAMMER_GRIP),
            partial(make_hammer, HANGING_CLAW_HAMMER),
            draw_weight=3.0,
        ),
        ToolSpec(
            ToolKind.WOODEN_MALLET,
            101,
            Family.HAMMERS,
            (Category.HAMMER_HEAD,),
            partial(make_hammer, WOODEN_MALLET),
            draw_weight=0.8,
        ),
        ToolSpec(
            ToolKind.MEAT_TENDERISER,
            102,
            Family.HAMMERS,
            (Category.HAMMER_HEAD,),
            partial(make_hammer, MEAT_TENDERISER),
            draw_weight=0.6,
        ),
        ToolSpec(
            ToolKind.SLEDGE_HAMMER,
            103,
            Family.HAMMERS,
            (Category.HAMMER_HEAD,),
            partial(make_hammer, SLEDGE_HAMMER),
            draw_weight=0.6,
        ),
        ToolSpec(
            ToolKind.LONG_SLOTTED_SCREWDRIVER,
            104,
            Family.SCREWDRIVERS,
            (Category.SCREWDRIVER_HEAD,),
            partial(make_screwdriver, slotted_tip, long_shaft),
            draw_weight=0.75,
        ),
        ToolSpec(
            ToolKind.LONG_PHILLIPS_SCREWDRIVER,
            105,
            Family.SCREWDRIVERS,
            (Category.SCREWDRIVER_HEAD,),
            partial(make_screwdriver, phillips_tip, long_shaft),
            draw_weight=0.75,
        ),
        ToolSpec(
            ToolKind.PIPE_WRENCH, 106, Family.WRENCHES, (Category.WRENCH_HEAD,), make_pipe_wrench, draw_weight=0.9
        ),
        ToolSpec(
            ToolKind.MONKEY_WRENCH, 107, Family.WRENCHES, (Category.WRENCH_HEAD,), make_monkey_wrench, draw_weight=0.6
        ),
        ToolSpec(
            ToolKind.EYE_ADJUSTABLE_WRENCH, 108, Family.WRENCHES, (Category.WRENCH_HEAD,), make_wrench, draw_weight=1.0
        ),
    )
}
"""All kinds, ordered by `ToolSpec.number`."""

NAIL_DRIVERS: tuple[ToolKind, ...] = tuple(kind for kind, spec in TOOL_SPECS.items() if spec.drives_nails)
"""Kinds that can drive a nail: hammers with a hard face."""


def kinds_of(family: Family) -> tuple[ToolKind, ...]:
    """The kinds of a family, ordered by number."""
    return tuple(kind for kind, spec in TOOL_SPECS.items() if spec.family is family)


@lru_cache(maxsize=512)
def make_tool(kind: ToolKind, seed: int) -> Tool:
    """The tool of a kind and a seed; equal arguments give equal tools.

    Tools are cached and shared between callers: do not modify their meshes.

    Args:
        kind: Kind of the tool.
        seed: Instance number, 0 or more.

    Returns:
        The tool, in its `tool` frame [m].

    Raises:
        UserError: The seed is negative.
    """
    if seed < 0:
        raise UserError(f"the seed must be 0 or more, got {seed}", code="user.seed_negative")
    spec = TOOL_SPECS[ToolKind(kind)]
    return spec.make(spec.kind, seed, np.random.default_rng([spec.number, seed]))


# Release the solids before manifold3d is unloaded at exit; it would report them as leaked.
atexit.register(make_tool.cache_clear)


def split(seed: int) -> Literal["train", "test"]:
    """The split of a seed, for every kind: each fifth seed is held out from training ("test")."""
    return "test" if seed % 5 == 4 else "train"


def role(seed: int) -> Literal["train", "validation", "test"]:
    """The use of a seed, for every kind: of the held-out seeds every second one is for validation.

    Confidence, covariance and every choice are made on validation tools (4, 14, 24, ...), a release is scored on test
    tools (9, 19, 29, ...).
    """
    if split(seed) == "train":
        return "train"
    return "validation" if seed % 2 == 0 else "test"


def train_seeds(n: int) -> tuple[int, ...]:
    """The first n training seeds, ascending."""
    return tuple(islice((s for s in count() if split(s) == "train"), n))


def test_seeds(n: int) -> tuple[int, ...]:
    """The first n held-out seeds, ascending."""
    return tuple(islice((s for s in count() if split(s) == "test"), n))


test_seeds.__test__ = False  # type: ignore[attr-defined]  # not a pytest test
