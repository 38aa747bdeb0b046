"""Custom tools of a data set: a record in `dataset.json` and a mesh in `tools/`."""

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
        record: Its description.
    """

    index: int
    record: CustomToolRecord

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
        return CustomTool(record.name, parts, mesh, owner, ees, handle, index, record)


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
