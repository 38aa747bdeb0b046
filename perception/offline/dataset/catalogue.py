"""Catalogues of the tools of a data set, by number: generated or custom tools."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.perception.offline.dataset.custom_tools import CustomTool, CustomToolRecord
from toolee_robot.perception.offline.dataset.instances import read_ply, tool_path
from toolee_robot.perception.offline.dataset.records import INSTANCES, draw
from toolee_robot.tools import TOOL_SPECS, Family, Tool, ToolKind, ToolShape, kinds_of, make_tool, tool_name
from toolee_robot.tools.catalog import role as role_of
from toolee_robot.tools.catalog import split as split_of

FIRST_KINDS = 13
"""Number of kinds that data sets drew from before they said from how many."""
_CUSTOM = FIRST_KINDS * INSTANCES
"""Number of the first custom tool. It is written in data sets, in object ids, so it does not grow with the kinds: the
first 13 of them lie below, later ones (numbered from 100) above the range of the custom tools."""
_POOL = 12
"""Size of the pool of tools of a scene folder."""
_DRAWN = (*[Family.HAMMERS] * 4, *[Family.SCREWDRIVERS] * 5, *[Family.WRENCHES] * 3)
"""Families of the tools in the pool; station scenes show additional hammers."""


@dataclass(frozen=True)
class Listed:
    """What a catalogue knows of a tool without making it.

    Attributes:
        name: `ToolShape.name`.
        role: Use of the tool: "train", "validation" or "test" (`tools.catalog.role`).
        categories: Distinct categories of its EEs, the working end first.
        about: Its fields in scene_instances.json, besides its objects.
    """

    name: str
    role: str
    categories: tuple[Category, ...]
    about: dict[str, Any]


class Catalogue(ABC):
    """Tools of a data set by number.

    Every method with an argument `number` raises UserError if there is no tool of this number.
    """

    @abstractmethod
    def numbers(self, split: str) -> list[int]:
        """Numbers of all tools of a split, "train" or "test"."""

    @abstractmethod
    def pool(self, rng: np.random.Generator, split: str) -> tuple[int, ...]:
        """Draw about a dozen tools of a split, for one scene folder.

        Args:
            rng: Random generator.
            split: "train" or "test".

        Returns:
            Numbers of the tools.
        """

    @abstractmethod
    def listed(self, number: int) -> Listed:
        """What is known of a tool without making it."""

    @abstractmethod
    def tool(self, number: int) -> ToolShape:
        """The tool; repeated calls return the same object while it is cached."""

    def name(self, number: int) -> str:
        """`ToolShape.name` of a tool."""
        return self.listed(number).name

    def role(self, number: int) -> str:
        """Use of a tool, see `Listed`."""
        return self.listed(number).role

    def split(self, number: int) -> str:
        """Split of a tool: "train", or "test" where it is held out."""
        return "train" if self.role(number) == "train" else "test"


def number_of(tool: ToolShape) -> int:
    """Number of a tool in its catalogue."""
    if isinstance(tool, CustomTool):
        return _CUSTOM + tool.index
    assert isinstance(tool, Tool)
    return TOOL_SPECS[tool.kind].number * INSTANCES + tool.seed


class GeneratedTools(Catalogue):
    """Generated tools: `INSTANCES` of each kind; each fifth is held out.

    Args:
        kinds: Number of kinds, the first ones of `TOOL_SPECS`.
    """

    def __init__(self, kinds: int) -> None:
        self._kinds = {TOOL_SPECS[kind].number: kind for kind in tuple(TOOL_SPECS)[:kinds]}

    def __reduce__(self) -> tuple[Any, ...]:
        # Unpickle to one instance per process.
        return generated_tools, (len(self._kinds),)

    def numbers(self, split: str) -> list[int]:
        return [k * INSTANCES + seed for k in self._kinds for seed in range(INSTANCES) if split_of(seed) == split]

    def pool(self, rng: np.random.Generator, split: str) -> tuple[int, ...]:
        numbers = []
        for family in _DRAWN:
            kinds = [kind for kind in kinds_of(family) if TOOL_SPECS[kind].number in self._kinds]
            weights = np.array([TOOL_SPECS[kind].draw_weight for kind in kinds])
            kind = kinds[int(rng.choice(len(kinds), p=weights / weights.sum()))]
            numbers.append(TOOL_SPECS[kind].number * INSTANCES + draw(rng, split, INSTANCES))
        return tuple(numbers)

    def listed(self, number: int) -> Listed:
        kind, seed = self._which(number)
        about = {"kind": str(kind), "seed": seed}
        return Listed(tool_name(kind, seed), role_of(seed), TOOL_SPECS[kind].end_effectors, about)

    def tool(self, number: int) -> Tool:
        return make_tool(*self._which(number))

    def _which(self, number: int) -> tuple[ToolKind, int]:
        kind, seed = divmod(number, INSTANCES)
        if kind not in self._kinds:
            raise UserError(f"there is no generated tool {number}: the data set is another's")
        return self._kinds[kind], seed


@lru_cache(maxsize=8)
def generated_tools(kinds: int) -> GeneratedTools:
    """The generated tools of the first kinds of `TOOL_SPECS`.

    Args:
        kinds: Number of kinds.

    Returns:
        The catalogue; equal arguments give the same object.
    """
    return GeneratedTools(kinds)


GENERATED = generated_tools(len(TOOL_SPECS))


@dataclass(frozen=True, eq=False)
class CustomTools(Catalogue):
    """Custom tools of a data set, all held out.

    Attributes:
        root: Folder of the data set.
        records: Descriptions of the tools, in the order of their numbers.
    """

    root: Path
    records: tuple[CustomToolRecord, ...]
    _made: dict[int, CustomTool] = field(default_factory=dict)

    def __reduce__(self) -> tuple[Any, ...]:
        # Unpickle to one instance per folder and process, so that derived data of its tools is cached once.
        return _custom_tools, (self.root, self.records)

    def numbers(self, split: str) -> list[int]:
        return [_CUSTOM + i for i in range(len(self.records))] if split == "test" else []

    def pool(self, rng: np.random.Generator, split: str) -> tuple[int, ...]:
        """Draw `_POOL` tools of a split, or all if there are fewer.

        Args:
            rng: Random generator.
            split: "train" or "test".

        Returns:
            Numbers of the tools.
        """
        numbers = self.numbers(split)
        return tuple(numbers[int(i)] for i in rng.permutation(len(numbers))[:_POOL])

    def listed(self, number: int) -> Listed:
        record = self._record(number)
        return Listed(record.name, "test", record.categories, {})

    def tool(self, number: int) -> CustomTool:
        """The tool of a number.

        Raises:
            AssetError: The mesh is missing or corrupt.
            UserError: There is no tool of this number.
        """
        record = self._record(number)
        if number not in self._made:
            vertices, faces = read_ply(tool_path(self.root, record.name))
            self._made[number] = CustomTool.build(record, number - _CUSTOM, 1e-3 * vertices, faces)
        return self._made[number]

    def _record(self, number: int) -> CustomToolRecord:
        if not 0 <= number - _CUSTOM < len(self.records):
            raise UserError(f"there is no tool {number} in this data set")
        return self.records[number - _CUSTOM]


@lru_cache(maxsize=8)
def _custom_tools(root: Path, records: tuple[CustomToolRecord, ...]) -> CustomTools:
    return CustomTools(root, records)
