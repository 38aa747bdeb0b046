"""The meshes of the tools that a data set shows: `models/` (BOP's: one EE of one tool each) and `tools/` (whole)."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import AssetError
from toolee_robot.frames import Array
from toolee_robot.perception.dataset.instances import (
    ee_mesh,
    instance_name,
    model_info,
    object_id,
    object_of,
    ply_bytes,
)
from toolee_robot.perception.dataset.storage import json_by_line
from toolee_robot.tools import make_tool
from toolee_robot.tools.catalog import split
from toolee_robot.types import Category

MODELS, TOOLS = "models", "tools"


def model_path(root: Path, obj_id: int) -> Path:
    """The EE's mesh, in its own frame [mm]."""
    return root / MODELS / f"obj_{obj_id:06d}.ply"


def tool_path(root: Path, name: str) -> Path:
    """The tool's mesh, `tool` frame [mm]."""
    return root / TOOLS / f"{name}.ply"


def write_models(root: Path, obj_ids: Iterable[int]) -> None:
    """The meshes of these objects and of their tools, where they are not there yet."""
    for kind, seed in sorted({object_of(obj_id)[:2] for obj_id in obj_ids}):
        tool = make_tool(kind, seed)
        for k in range(len(tool.ees)):
            path = model_path(root, object_id(kind, seed, k))
            if not path.exists():
                mesh = ee_mesh(tool, k)
                _write(path, ply_bytes(np.asarray(mesh.vertices), np.asarray(mesh.faces)))
        path = tool_path(root, tool.name)
        if not path.exists():
            _write(path, ply_bytes(1e3 * np.asarray(tool.mesh.vertices), np.asarray(tool.mesh.faces)))


def write_models_info(root: Path, categories: dict[int, Category], out: Path) -> None:
    """models_info.json of these objects (obj_id -> category), in `out`."""
    entries = {}
    for obj_id in sorted(categories):
        kind, seed, _ = object_of(obj_id)
        info = model_info(read_ply(model_path(root, obj_id))[0], categories[obj_id])
        more = {"category": str(categories[obj_id]), "instance": instance_name(kind, seed), "split": split(seed)}
        entries[str(obj_id)] = {**info, **more}
    _write(out / MODELS / "models_info.json", json_by_line(entries))


def read_ply(path: Path) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) float64 [mm] and faces (F, 3) of a mesh of this storage. Raises AssetError."""
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
        raise AssetError(f"cannot read {path}: {error!r}; delete it and generate the data set again") from error
    faces = rows["v"].astype(np.int64)
    if not np.all(np.isfinite(vertices)) or (F and (faces.min() < 0 or faces.max() >= V)):
        raise AssetError(f"{path} is no mesh: delete it and generate the data set again")
    return vertices, faces


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(exist_ok=True)
    scratch = path.with_name(f".{path.name}.{os.getpid()}.part")
    scratch.write_bytes(data)
    scratch.replace(path)
