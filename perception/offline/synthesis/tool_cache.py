"""File cache of generated tools for the duration of a run.

Reading a tool is ten times faster than generating it, and a large data set shows each tool in many scenes.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from toolee_robot.end_effectors import Category
from toolee_robot.perception.offline.dataset.catalogue import Catalogue, StoredTool
from toolee_robot.perception.offline.synthesis.bodies import tool_meshes
from toolee_robot.render import Mesh
from toolee_robot.runtime.files import write_atomic
from toolee_robot.tools import EndEffector, Handle, Material, Part, ToolShape

TOOL_CACHE = ".tools.part"
"""Folder of the cache in the data set; everything with this suffix is removed when a run begins or ends."""


class ToolCache(Catalogue):
    """Cache of another catalogue, shared by the processes of a run.

    Args:
        source: Catalogue that generates the tools.
        root: Folder of the data set.
    """

    def __init__(self, source: Catalogue, root: Path) -> None:
        self._source, self._folder = source, root / TOOL_CACHE
        self._made: dict[int, StoredTool] = {}

    def numbers(self, split: str) -> list[int]:
        return self._source.numbers(split)

    def pool(self, rng: np.random.Generator, split: str) -> tuple[int, ...]:
        return self._source.pool(rng, split)

    def name(self, number: int) -> str:
        return self._source.name(number)

    def split(self, number: int) -> str:
        return self._source.split(number)

    def role(self, number: int) -> str:
        return self._source.role(number)

    def categories(self, number: int) -> tuple[Category, ...]:
        return self._source.categories(number)

    def about(self, number: int) -> dict[str, Any]:
        return self._source.about(number)

    def tool(self, number: int) -> StoredTool:
        if number not in self._made:
            path = self._folder / f"{number:06d}.npz"
            if not path.exists():
                self._folder.mkdir(exist_ok=True)
                write_atomic(path, _packed(self._source.tool(number)))
            self._made[number] = _unpacked(path, number)
        return self._made[number]


def _packed(tool: ToolShape) -> bytes:
    about = {
        "name": tool.name,
        "parts": [{"label": part.label, "material": asdict(part.material)} for part in tool.parts],
        "categories": [str(ee.category) for ee in tool.ees],
    }
    file = BytesIO()
    np.savez(
        file,
        about=np.array(json.dumps(about)),
        vertices=np.asarray(tool.mesh.vertices),
        faces=np.asarray(tool.mesh.faces, np.int32),
        face_parts=tool.face_parts.astype(np.uint8),
        corner_normals=np.concatenate([mesh.corner_normals for mesh in tool_meshes(tool)]),
        Xs_tool_ee=np.stack([ee.X_tool_ee for ee in tool.ees]),
        handle=np.stack([tool.handle.z, tool.handle.radii_x, tool.handle.radii_y]),
    )
    return file.getvalue()


def _unpacked(path: Path, number: int) -> StoredTool:
    with np.load(path, allow_pickle=False) as file:
        about = json.loads(str(file["about"]))
        vertices, faces, normals = file["vertices"], file["faces"], file["corner_normals"]
        face_parts, Xs, sections = file["face_parts"].astype(np.int64), file["Xs_tool_ee"], file["handle"]
    parts = tuple(Part(part["label"], _material(part["material"])) for part in about["parts"])
    ees = tuple(EndEffector(Category(c), X) for c, X in zip(about["categories"], Xs, strict=True))
    present = [face_parts == part for part in range(len(parts)) if np.any(face_parts == part)]
    ends = np.cumsum([np.count_nonzero(of_part) for of_part in present])
    corners = np.split(normals, ends[:-1])
    rounded = vertices.astype(np.float32)
    meshes = tuple(Mesh(rounded, faces[of], n, lasting=True) for of, n in zip(present, corners, strict=True))
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return StoredTool(about["name"], parts, mesh, face_parts, ees, Handle(*sections), number, meshes)


def _material(fields: dict[str, Any]) -> Material:
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in fields.items()}
    return Material(**values)
