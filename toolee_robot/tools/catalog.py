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
from typing import Any, Literal

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
    HammerShape,
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

Maker = Callable[[ToolKind, int, np.random.Generator], Tool]


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
    make: Maker
    """Generator, called with the kind, the seed and the random generator of the tool."""
    drives_nails: bool = False
    """Whether it can drive a nail: used by the simulated person's hand-overs and the strike checks of the doctor."""
    draw_weight: float = 1.0
    """Relative sampling weight in data sets, among the kinds of its family."""
    training_share: int = 1
    """Factor on the number of its tools that are sampled for training."""


def _hammer(kind: ToolKind, number: int, shape: HammerShape, *, claw: bool = False, **more: Any) -> ToolSpec:
    ends = (Category.HAMMER_HEAD, Category.HAMMER_GRIP) if claw else (Category.HAMMER_HEAD,)
    return ToolSpec(kind, number, Family.HAMMERS, ends, partial(make_hammer, shape), **more)


def _screwdriver(kind: ToolKind, number: int, tip: Any, shaft: Any = common_shaft, **more: Any) -> ToolSpec:
    make = partial(make_screwdriver, tip, shaft)
    return ToolSpec(kind, number, Family.SCREWDRIVERS, (Category.SCREWDRIVER_HEAD,), make, **more)


def _wrench(kind: ToolKind, number: int, make: Maker = make_wrench, **more: Any) -> ToolSpec:
    return ToolSpec(kind, number, Family.WRENCHES, (Category.WRENCH_HEAD,), make, **more)


TOOL_SPECS: dict[ToolKind, ToolSpec] = {
    spec.kind: spec
    for spec in (
        # Claws are the class with the fewest examples: a higher weight balances the classes.
        _hammer(ToolKind.CLAW_HAMMER, 0, CLAW_HAMMER, claw=True, drives_nails=True, draw_weight=6.0, training_share=2),
        _hammer(ToolKind.BALL_PEEN_HAMMER, 1, BALL_PEEN_HAMMER, drives_nails=True),
        _hammer(ToolKind.CROSS_PEEN_HAMMER, 2, CROSS_PEEN_HAMMER, drives_nails=True),
        _hammer(ToolKind.CLUB_HAMMER, 3, CLUB_HAMMER, drives_nails=True),
        _hammer(ToolKind.MALLET, 4, MALLET),
        _screwdriver(ToolKind.SLOTTED_SCREWDRIVER, 5, slotted_tip),
        _screwdriver(ToolKind.PHILLIPS_SCREWDRIVER, 6, phillips_tip),
        _screwdriver(ToolKind.NUT_DRIVER, 7, nut_tip),
        _wrench(ToolKind.OPEN_END_WRENCH, 8),
        _wrench(ToolKind.COMBINATION_WRENCH, 9),
        _wrench(ToolKind.ADJUSTABLE_WRENCH, 10),
        _wrench(ToolKind.BOX_WRENCH, 11),
        _wrench(ToolKind.SOCKET_WRENCH, 12),
        # 13 to 99 stay free: data sets number custom tools from where kind 13 would begin (`dataset.catalogue`).
        # A third of each family's draws are of the kinds below, which drive no nails, so that jobs keep their hammers.
        _hammer(ToolKind.HANGING_CLAW_HAMMER, 100, HANGING_CLAW_HAMMER, claw=True, draw_weight=3.0),
        _hammer(ToolKind.WOODEN_MALLET, 101, WOODEN_MALLET, draw_weight=0.8),
        _hammer(ToolKind.MEAT_TENDERISER, 102, MEAT_TENDERISER, draw_weight=0.6),
        _hammer(ToolKind.SLEDGE_HAMMER, 103, SLEDGE_HAMMER, draw_weight=0.6),
        _screwdriver(ToolKind.LONG_SLOTTED_SCREWDRIVER, 104, slotted_tip, long_shaft, draw_weight=0.75),
        _screwdriver(ToolKind.LONG_PHILLIPS_SCREWDRIVER, 105, phillips_tip, long_shaft, draw_weight=0.75),
        _wrench(ToolKind.PIPE_WRENCH, 106, make_pipe_wrench, draw_weight=0.9),
        _wrench(ToolKind.MONKEY_WRENCH, 107, make_monkey_wrench, draw_weight=0.6),
        _wrench(ToolKind.EYE_ADJUSTABLE_WRENCH, 108),
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
