"""A user's own tools as a data set holds them: a record in `dataset.json`, the mesh in `tools/`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.tools import EndEffector, Handle, Material, Part, ToolShape, materials

MATERIALS: dict[str, Material] = {m.name: m for m in vars(materials).values() if isinstance(m, Material)}
"""What a handle or a head may be made of."""
HANDLE, HEAD, CLAW = "handle", "head", "claw"
_FINE, _CUTS = 0.006, 10
"""Triangles across a border of parts are halved until their edges are that short [m], at most so many times."""
_ON_HANDLE = 1.5
"""A surface belongs to the handle up to this factor of the handle's half-widths."""


@dataclass(frozen=True)
class CustomToolRecord:
    """mesh_sha256: of the mesh in `tools/`. Xs_tool_ee: 16 numbers row by row for each of `categories`; sections: z,
    half-widths along x and along y as in `Handle`. handle_material, head_material: names in `MATERIALS`."""

    name: str
    mesh_sha256: str
    categories: tuple[Category, ...]
    Xs_tool_ee: tuple[tuple[float, ...], ...]
    sections: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
    handle_material: str
    head_material: str

    @property
    def ees(self) -> tuple[EndEffector, ...]:
        rows = zip(self.categories, self.Xs_tool_ee, strict=True)
        return tuple(EndEffector(category, np.reshape(X, (4, 4))) for category, X in rows)

    @property
    def handle(self) -> Handle:
        return Handle(*(np.array(row) for row in self.sections))

    def to_json(self) -> dict[str, Any]:
        """Plain lists, for `dataset.json`."""
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
        """Raises KeyError, TypeError, ValueError."""
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
    """A tool as it was read from its user's folder. ply: its mesh, `tool` frame [mm], as `tools/` is to hold it."""

    record: CustomToolRecord
    ply: bytes


@dataclass(frozen=True, eq=False, repr=False)
class CustomTool(ToolShape):
    """A tool that a user brought. index: its place among the data set's own tools.

    Its parts are a handle, a head and, if it has a grip, a claw: what lies along the handle's axis, what is near the
    grip's origin and not on the other side of that axis, and the rest.
    """

    index: int
    record: CustomToolRecord

    @staticmethod
    def build(record: CustomToolRecord, index: int, vertices: Array, faces: NDArray[np.int64]) -> CustomTool:
        """vertices (V, 3): `tool` frame [m]."""
        head = MATERIALS[record.head_material]
        parts = (Part(HANDLE, MATERIALS[record.handle_material]), Part(HEAD, head), Part(CLAW, head))
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        ees, handle = record.ees, record.handle
        owner = _owners(vertices[faces].mean(axis=1), ees, handle)
        return CustomTool(record.name, parts, mesh, owner, ees, handle, index, record)


def cut_at_parts(
    record: CustomToolRecord, vertices: Array, faces: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    """The same surface, `tool` frame [m], the triangles across a border of parts cut until they are small: a drawing's
    may run from head to claw."""
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
    """Index into the parts of each point (N, 3) of the surface, `tool` frame."""
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
