"""Mesh files of a data set: `models/` (BOP models, one EE of one tool each) and `tools/` (whole tools)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.perception.offline.dataset.catalogue import Catalogue
from toolee_robot.perception.offline.dataset.instances import (
    MODELS,
    ee_mesh,
    model_info,
    model_path,
    object_id,
    object_of,
    ply_bytes,
    read_ply,
    tool_path,
)
from toolee_robot.perception.offline.dataset.scene_writer import json_by_line
from toolee_robot.runtime.files import write_atomic


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
