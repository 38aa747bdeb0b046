"""Tools and their EEs as objects of a BOP data set: names, object ids, meshes in millimetres, symmetries."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from toolee_robot.errors import UserError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.perception.dataset.records import INSTANCES
from toolee_robot.symmetry import SymmetryKind
from toolee_robot.tools import Tool, ToolKind, ee_radius, make_tool
from toolee_robot.tools.catalog import split as split_of
from toolee_robot.types import Category

_KINDS = tuple(ToolKind)
_EES = 4
_EDGE = 0.008
"""Longest edge [m] where an EE's mesh is cut out of its tool's."""


def object_id(kind: ToolKind, seed: int, ee: int) -> int:
    """The BOP obj_id (1 or more) of EE `ee` (its place in `Tool.ees`) of a tool. Object: one EE of one tool."""
    return (_KINDS.index(kind) * INSTANCES + seed) * _EES + ee + 1


def object_of(obj_id: int) -> tuple[ToolKind, int, int]:
    """Kind, seed and EE of an obj_id. Raises UserError for numbers that are none."""
    tool, ee = divmod(obj_id - 1, _EES)
    kind, seed = divmod(tool, INSTANCES)
    if obj_id < 1 or kind >= len(_KINDS):
        raise UserError(f"there is no object {obj_id}")
    return _KINDS[kind], seed, ee


def instance_name(kind: ToolKind, seed: int) -> str:
    """As `Tool.name`, without making the tool."""
    return f"{kind}-{seed:04d}"


def instances(split: str) -> list[tuple[ToolKind, int]]:
    """All tools of a split."""
    return [(kind, seed) for kind in ToolKind for seed in range(INSTANCES) if split_of(seed) == split]


@lru_cache(maxsize=1)
def kind_categories() -> dict[ToolKind, tuple[Category, ...]]:
    """What EEs the tools of each kind have."""
    return {kind: tuple(ee.category for ee in make_tool(kind, 0).ees) for kind in ToolKind}


def ee_mesh(tool: Tool, ee: int) -> trimesh.Trimesh:
    """The part of the tool's surface within `ee_radius` of the EE's origin, in the EE's frame [mm]."""
    end = tool.ees[ee]
    radius = ee_radius(end.category)
    X = inverse(end.X_tool_ee)
    vertices = np.asarray(tool.mesh.vertices) @ X[:3, :3].T + X[:3, 3]
    triangles = vertices[np.asarray(tool.mesh.faces)]
    near = trimesh.triangles.closest_point(triangles, np.zeros((len(triangles), 3)))  # type: ignore[no-untyped-call]
    faces = np.asarray(tool.mesh.faces)[np.linalg.norm(near, axis=1) < radius]
    cut = trimesh.remesh.subdivide_to_size(vertices, faces, _EDGE, max_iter=20)  # type: ignore[no-untyped-call]
    vertices, faces = cut
    centres = vertices[faces].mean(axis=1)
    mesh = trimesh.Trimesh(1e3 * vertices, faces[np.linalg.norm(centres, axis=1) < radius], process=False)
    mesh.merge_vertices()
    mesh.remove_unreferenced_vertices()
    return mesh


def ply_bytes(vertices: Array, faces: NDArray[np.int64]) -> bytes:
    """A binary PLY file: float32 vertices (V, 3), int32 faces (F, 3)."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(faces), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    rows["n"], rows["v"] = 3, faces
    return header.encode() + np.asarray(vertices, "<f4").tobytes() + rows.tobytes()


def model_info(vertices: Array, category: Category) -> dict[str, Any]:
    """A model's entry in models_info.json: diameter, bounding box [mm], symmetries about the EE's axes."""
    hull = trimesh.convex.convex_hull(np.asarray(vertices, np.float64)).vertices
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    info: dict[str, Any] = {"diameter": round(float(pdist(hull).max()), 4)}
    info |= {f"min_{axis}": round(float(v), 4) for axis, v in zip("xyz", low, strict=True)}
    info |= {f"size_{axis}": round(float(v), 4) for axis, v in zip("xyz", size, strict=True)}
    group = category.symmetry
    axis = np.asarray(group.axis)
    if group.kind is SymmetryKind.CINF:
        info["symmetries_continuous"] = [{"axis": axis.tolist(), "offset": [0.0, 0.0, 0.0]}]
    elif group.kind is SymmetryKind.C2:
        # A half turn about a unit axis; exact for the coordinate axes that are meant here.
        half_turn = transform(2.0 * np.outer(axis, axis) - np.eye(3))
        info["symmetries_discrete"] = [[float(v) for v in half_turn.reshape(-1)]]
    return info
