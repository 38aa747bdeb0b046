"""Tools by kind and seed, and the split into training and held-out instances."""

from __future__ import annotations

import atexit
from functools import lru_cache
from itertools import count, islice
from typing import Literal

import numpy as np

from toolee_robot.errors import UserError
from toolee_robot.tools.hammers import make_hammer
from toolee_robot.tools.model import Family, Tool, ToolKind
from toolee_robot.tools.screwdrivers import make_screwdriver
from toolee_robot.tools.wrenches import make_wrench

_MAKERS = {Family.HAMMERS: make_hammer, Family.SCREWDRIVERS: make_screwdriver, Family.WRENCHES: make_wrench}


@lru_cache(maxsize=512)
def make_tool(kind: ToolKind, seed: int) -> Tool:
    """The tool of that kind and seed (0 or more), always the same one. Tools are shared: do not change their meshes."""
    if seed < 0:
        raise UserError(f"the seed must be 0 or more, got {seed}")
    kind = ToolKind(kind)
    rng = np.random.default_rng([list(ToolKind).index(kind), seed])
    return _MAKERS[kind.family](kind, seed, rng)


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
