"""Tools and their EEs as objects of a BOP data set: ids, meshes in millimetres, symmetries, `models_info.json`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist

from toolee_robot.end_effectors import Category
from toolee_robot.errors import AssetError, UserError, words_of
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.perception.offline.dataset.records import json_by_line
from toolee_robot.runtime.files import write_atomic
from toolee_robot.symmetry import SymmetryKind
from toolee_robot.tools import ToolShape

if TYPE_CHECKING:
    from toolee_robot.perception.offline.dataset.catalogue import Catalogue

MODELS, TOOLS = "models", "tools"
_EES = 4
_EDGE = 0.008
"""Maximum edge length [m] of the mesh of an EE."""


def object_id(tool: int, ee: int) -> int:
    """BOP obj_id (1 or more); an object is one EE of one tool.

    Args:
        tool: Number of the tool in its catalogue.
        ee: Index into `ToolShape.ees`.

    Returns:
        The id.
    """
    return tool * _EES + ee + 1


def object_of(obj_id: int) -> tuple[int, int]:
    """Number of the tool and index of the EE of an obj_id.

    Raises:
        UserError: obj_id is less than 1.
    """
    if obj_id < 1:
        raise UserError(f"there is no object {obj_id}")
    return divmod(obj_id - 1, _EES)


def model_path(root: Path, obj_id: int) -> Path:
    """Path of the mesh of an EE, EE frame [mm].

    Args:
        root: Folder of the data set.
        obj_id: BOP object id, see `object_id`.

    Returns:
        The path.
    """
    return root / MODELS / f"obj_{obj_id:06d}.ply"


def tool_path(root: Path, name: str) -> Path:
    """Path of the mesh of a tool, `tool` frame [mm].

    Args:
        root: Folder of the data set.
        name: Name of the tool.

    Returns:
        The path.
    """
    return root / TOOLS / f"{name}.ply"


def ee_mesh(tool: ToolShape, ee: int) -> trimesh.Trimesh:
    """Surface of a tool near one of its EEs, within `EndEffectorSpec.radius` of the EE's origin.

    Args:
        tool: The tool.
        ee: Index into `ToolShape.ees`.

    Returns:
        The surface, EE frame [mm].
    """
    end = tool.ees[ee]
    radius = end.category.spec.radius
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
    """Content of a binary PLY file with float32 vertices and int32 faces.

    Args:
        vertices: Vertices, (V, 3).
        faces: Indices of each triangle's vertices, (F, 3).

    Returns:
        The content.
    """
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(faces), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    rows["n"], rows["v"] = 3, faces
    return header.encode() + np.asarray(vertices, "<f4").tobytes() + rows.tobytes()


def read_ply(path: Path) -> tuple[Array, NDArray[np.int64]]:
    """Read a mesh written by `ply_bytes`.

    Returns:
        Vertices (V, 3) [mm] and faces (F, 3).

    Raises:
        AssetError: The file is missing or corrupt.
    """
    try:
        data = path.read_bytes()
        end = data.index(b"end_header\n") + len(b"end_header\n")
        header = data[:end].decode().split("\n")
        V, F = (
            int(next(line for line in header if line.startswith(f"element {n}")).split()[2]) for n in ("vertex", "face")
        )
        vertices = np.frombuffer(data, "<f4", 3 * V, end).reshape(V, 3).astype(np.float64)
        rows = np.frombuffer(data, np.dtype([("n", "u1"), ("v", "<i4", 3)]), F, end + 12 * V)
    except (OSError, ValueError, StopIteration, IndexError) as error:
        raise AssetError(f"cannot read {path}: {words_of(error)}; delete it and generate the data set again") from error
    faces = rows["v"].astype(np.int64)
    if not np.all(np.isfinite(vertices)) or (F and (faces.min() < 0 or faces.max() >= V)):
        raise AssetError(f"{path} is not a mesh: delete it and generate the data set again")
    return vertices, faces


def model_info(vertices: Array, category: Category) -> dict[str, Any]:
    """Entry of a model in models_info.json, as BOP defines it.

    Args:
        vertices: Vertices of the model, EE frame, (V, 3) [mm].
        category: Category of the EE, which decides the symmetries.

    Returns:
        Diameter, bounding box [mm] and symmetries.
    """
    try:
        hull = ConvexHull(vertices)
    except QhullError:  # flat
        hull = ConvexHull(vertices, qhull_options="QJ")
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    info: dict[str, Any] = {"diameter": round(float(pdist(vertices[hull.vertices]).max()), 4)}
    info |= {f"min_{axis}": round(float(v), 4) for axis, v in zip("xyz", low, strict=True)}
    info |= {f"size_{axis}": round(float(v), 4) for axis, v in zip("xyz", size, strict=True)}
    group = category.symmetry
    axis = np.asarray(group.axis)
    if group.kind is SymmetryKind.CINF:
        info["symmetries_continuous"] = [{"axis": axis.tolist(), "offset": [0.0, 0.0, 0.0]}]
    elif group.kind is SymmetryKind.C2:
        # Rotation by 180 degrees about a unit axis; exact for coordinate axes.
        half_turn = transform(2.0 * np.outer(axis, axis) - np.eye(3))
        info["symmetries_discrete"] = [[float(v) for v in half_turn.reshape(-1)]]
    return info


def write_models(root: Path, catalogue: Catalogue, obj_ids: Iterable[int]) -> None:
    """Write the missing meshes of objects and of their tools.

    Args:
        root: Folder of the data set.
        catalogue: Its tools.
        obj_ids: BOP object ids.
    """
    for number in sorted({object_of(obj_id)[0] for obj_id in obj_ids}):
        tool = catalogue.tool(number)
        for k in range(len(tool.ees)):
            path = model_path(root, object_id(number, k))
            if not path.exists():
                mesh = ee_mesh(tool, k)
                _write(path, ply_bytes(np.asarray(mesh.vertices), np.asarray(mesh.faces)))
        path = tool_path(root, tool.name)
        if not path.exists():
            _write(path, ply_bytes(1e3 * np.asarray(tool.mesh.vertices), np.asarray(tool.mesh.faces)))


def model_entry(root: Path, catalogue: Catalogue, obj_id: int, category: Category) -> dict[str, Any]:
    """Entry of an object in models_info.json.

    Args:
        root: Folder of the data set.
        catalogue: Its tools.
        obj_id: BOP object id.
        category: Category of the EE.

    Returns:
        The entry: size and symmetries as in BOP [mm], category, instance and split.

    Raises:
        AssetError: The mesh is missing or corrupt.
    """
    number, _ = object_of(obj_id)
    info = model_info(read_ply(model_path(root, obj_id))[0], category)
    return {**info, "category": str(category), "instance": catalogue.name(number), "split": catalogue.split(number)}


def write_models_info(out: Path, entries: dict[int, dict[str, Any]]) -> None:
    """Write models_info.json.

    Args:
        out: Folder of the data set.
        entries: BOP object id -> entry, see `model_entry`.
    """
    _write(out / MODELS / "models_info.json", json_by_line({str(k): entries[k] for k in sorted(entries)}))


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(exist_ok=True)
    write_atomic(path, data)
