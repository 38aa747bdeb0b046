"""Tools of a data set by number: generated ones, and custom ones with a record in dataset.json and a mesh."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.perception.offline.dataset.instances import read_ply, tool_path
from toolee_robot.perception.offline.dataset.records import INSTANCES, draw
from toolee_robot.tools import (
    TOOL_SPECS,
    EndEffector,
    Family,
    Handle,
    Material,
    Part,
    Tool,
    ToolKind,
    ToolShape,
    kinds_of,
    make_tool,
    materials,
    tool_name,
)
from toolee_robot.tools.catalog import role as role_of
from toolee_robot.tools.catalog import split as split_of

MATERIALS: dict[str, Material] = {m.name: m for m in vars(materials).values() if isinstance(m, Material)}
"""Name -> material that a handle or a head can have."""
HANDLE, HEAD, CLAW = "handle", "head", "claw"
_FINE, _CUTS = 0.006, 10
"""Triangles across the border of two parts are subdivided to this edge length [m], in at most this many passes."""
_ON_HANDLE = 1.5
"""Surface points within this factor of the half-widths of the handle belong to the handle."""


@dataclass(frozen=True)
class CustomToolRecord:
    """Description of a custom tool.

    Attributes:
        name: Name of the tool and stem of its mesh file.
        mesh_sha256: SHA-256 of the mesh file in `tools/`.
        categories: Category of each EE, the working end first.
        Xs_tool_ee: Pose of each EE in the `tool` frame, 4x4 [m] as 16 numbers in row-major order.
        sections: z, half-widths along x and half-widths along y [m], as in `Handle`.
        handle_material: Material of the handle, a key of `MATERIALS`.
        head_material: Material of head and claw, a key of `MATERIALS`.
    """

    name: str
    mesh_sha256: str
    categories: tuple[Category, ...]
    Xs_tool_ee: tuple[tuple[float, ...], ...]
    sections: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
    handle_material: str
    head_material: str

    @property
    def ees(self) -> tuple[EndEffector, ...]:
        """End effectors, the working end first."""
        rows = zip(self.categories, self.Xs_tool_ee, strict=True)
        return tuple(EndEffector(category, np.reshape(X, (4, 4))) for category, X in rows)

    @property
    def handle(self) -> Handle:
        """Grippable section."""
        return Handle(*(np.array(row) for row in self.sections))

    def to_json(self) -> dict[str, Any]:
        """Entry of the tool in `dataset.json`."""
        return {
            "name": self.name,
            "mesh_sha256": self.mesh_sha256,
            "ees": [
                {"category": str(c), "X_tool_ee": list(X)}
                for c, X in zip(self.categories, self.Xs_tool_ee, strict=True)
            ],
            "handle": dict(zip(("z", "radii_x", "radii_y"), map(list, self.sections), strict=True)),
            "materials": {HANDLE: self.handle_material, HEAD: self.head_material},
        }

    @staticmethod
    def from_json(data: dict[str, Any]) -> CustomToolRecord:
        """Parse an entry of `dataset.json`.

        Raises:
            KeyError: A field is missing.
            TypeError: A field has another type.
            ValueError: A value is invalid.
        """
        z, x, y = (tuple(map(float, data["handle"][k])) for k in ("z", "radii_x", "radii_y"))
        return CustomToolRecord(
            data["name"],
            data["mesh_sha256"],
            tuple(Category(ee["category"]) for ee in data["ees"]),
            tuple(tuple(map(float, ee["X_tool_ee"])) for ee in data["ees"]),
            (z, x, y),
            data["materials"][HANDLE],
            data["materials"][HEAD],
        )


@dataclass(frozen=True, eq=False)
class CustomMesh:
    """A custom tool read from the folder of the user.

    Attributes:
        record: Its description.
        ply: Mesh in the `tool` frame [mm], the content of its file in `tools/`.
    """

    record: CustomToolRecord
    ply: bytes


@dataclass(frozen=True, eq=False, repr=False)
class CustomTool(ToolShape):
    """A custom tool.

    Its parts are handle, head and claw. The handle is the surface along the axis of the handle; the claw is the surface
    near the origin of a grip EE, on the same side of that axis; the head is the rest.

    Attributes:
        index: Index among the custom tools of the data set.
    """

    index: int

    @staticmethod
    def build(record: CustomToolRecord, index: int, vertices: Array, faces: NDArray[np.int64]) -> CustomTool:
        """Build a tool from its mesh.

        Args:
            record: Its description.
            index: Index among the custom tools of the data set.
            vertices: Vertices (V, 3) [m], `tool` frame.
            faces: Faces (F, 3).

        Returns:
            The tool, its faces assigned to handle, head and claw.
        """
        head = MATERIALS[record.head_material]
        parts = (Part(HANDLE, MATERIALS[record.handle_material]), Part(HEAD, head), Part(CLAW, head))
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        ees, handle = record.ees, record.handle
        owner = _owners(vertices[faces].mean(axis=1), ees, handle)
        return CustomTool(record.name, parts, mesh, owner, ees, handle, index)


def cut_at_parts(
    record: CustomToolRecord, vertices: Array, faces: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    """Subdivide the triangles across borders of parts; triangles of a CAD mesh can extend from head to claw.

    Args:
        record: Description of the tool.
        vertices: Vertices (V, 3) [m], `tool` frame.
        faces: Faces (F, 3).

    Returns:
        Vertices and faces of the same surface.
    """
    for _ in range(_CUTS):
        owner = _owners(vertices, record.ees, record.handle)[faces]
        corners = vertices[faces]
        long = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1) > _FINE
        across = np.flatnonzero((np.ptp(owner, axis=1) > 0) & long)
        if not len(across):
            break
        vertices, faces = trimesh.remesh.subdivide(vertices, faces, across)  # type: ignore[no-untyped-call]
    return vertices, faces


def _owners(points: Array, ees: tuple[EndEffector, ...], handle: Handle) -> NDArray[np.int64]:
    """Index into the parts (N,) of surface points (N, 3) [m], `tool` frame."""
    owner = np.full(len(points), 1)
    for ee in (ee for ee in ees if ee.category is Category.HAMMER_GRIP):
        local = transform_points(inverse(ee.X_tool_ee), points)
        near = np.linalg.norm(local, axis=1) < ee.category.spec.radius
        side = np.sign(ee.X_tool_ee[0, 3])
        owner[near & (side * points[:, 0] > handle.radii_at(handle.z_max)[0])] = 2
    x, y = (np.interp(points[:, 2], handle.z, radii) for radii in (handle.radii_x, handle.radii_y))
    beside = np.hypot(points[:, 0] / x, points[:, 1] / y)
    owner[(points[:, 2] <= handle.z_max) & (beside < _ON_HANDLE)] = 0
    return owner


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
