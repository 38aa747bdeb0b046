"""Files of the models, the meshes of their links, and the robots in the cache: URDF and meshes, named by content.

Robots that differ in their calibration share the meshes.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from toolee_robot.errors import AssetError, words_of
from toolee_robot.robots.tree import Link, Shape, Tree
from toolee_robot.robots.urdf import write_urdf

MODELS = Path(__file__).parent / "models"
"""Model files and licences of arms and hands, one folder each."""
UR10_URDF = MODELS / "ur10" / "ur10_robot.urdf"
SHADOW_HAND_URDF = MODELS / "shadow_hand" / "shadow_hand.urdf"
INSPIRE_RH56_URDF = MODELS / "inspire_rh56" / "inspire_rh56.urdf"
ABILITY_HAND_URDF = MODELS / "ability_hand" / "ability_hand.urdf"


def cache_folder() -> Path:
    """The cache folder; it is created if it does not exist.

    Returns:
        $XDG_CACHE_HOME/toolee_robot or, if the variable is not set, ~/.cache/toolee_robot; a folder in the temporary
        directory if that is not writable.
    """
    base = os.environ.get("XDG_CACHE_HOME")
    folder = (Path(base) if base else Path.home() / ".cache") / "toolee_robot"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"toolee_robot-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
        folder.mkdir(parents=True, exist_ok=True)
        return folder


def install_urdf(name: str, tree: Tree) -> Path:
    """Write a robot's URDF and meshes into the cache, unless they are there.

    Args:
        name: Name of the robot and of the file.
        tree: Its links.

    Returns:
        The URDF's path.
    """
    text = write_urdf(name, tree, _install_meshes(tree).__getitem__)
    folder = cache_folder() / f"robot-{hashlib.sha256(text.encode()).hexdigest()[:16]}"

    def write(scratch: Path) -> None:
        (scratch / f"{name}.urdf").write_text(text)

    _install_folder(folder, write)
    return folder / f"{name}.urdf"


def _install_meshes(tree: Tree) -> dict[Path, Path]:
    """Copy the meshes of a robot into the cache and return where each one lies."""
    owners = {shape.mesh: link for link in tree.links for shape in (*link.visuals, *link.collisions) if shape.mesh}
    names = {file: f"{link.name}_{file.name}" for file, link in owners.items()}
    probe = hashlib.sha256()
    for file, name in names.items():
        probe.update(name.encode() + file.read_bytes())
    folder = cache_folder() / f"meshes-{probe.hexdigest()[:16]}"

    def copy(scratch: Path) -> None:
        for file, name in names.items():
            shutil.copyfile(file, scratch / name)

    _install_folder(folder, copy)
    return {file: folder / name for file, name in names.items()}


def _install_folder(folder: Path, fill: Callable[[Path], None]) -> None:
    """Make a folder of the cache, whole or not at all, unless it is there."""
    if folder.is_dir():
        return
    scratch = Path(tempfile.mkdtemp(dir=folder.parent))
    try:
        fill(scratch)
        scratch.replace(folder)
    except OSError:  # another process installed it meanwhile
        shutil.rmtree(scratch, ignore_errors=True)
        if not folder.is_dir():
            raise


def cluster_vertices(mesh: trimesh.Trimesh, cell: float) -> trimesh.Trimesh:
    """Simplify a mesh by vertex clustering.

    Args:
        mesh: The mesh [m].
        cell: Edge of the cubes [m] whose vertices are merged into their mean.

    Returns:
        The mesh without degenerate and duplicate faces.
    """
    keys = np.floor(mesh.vertices / cell).astype(np.int64)
    _, index = np.unique(keys, axis=0, return_inverse=True)
    index = index.reshape(-1)
    count = np.bincount(index)
    vertices = np.column_stack([np.bincount(index, weights=mesh.vertices[:, k]) / count for k in range(3)])
    faces = index[mesh.faces]
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[keep]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return trimesh.Trimesh(vertices, faces[np.sort(first)], process=False)


def link_mesh(link: Link, cell: float | None) -> trimesh.Trimesh | None:
    """The visual mesh of a link.

    Args:
        link: The link.
        cell: Cell size [m] of `cluster_vertices`; None: no simplification.

    Returns:
        The mesh in the link frame [m]; None if the link has no visual.

    Raises:
        AssetError: A mesh file is missing or unreadable.
    """
    parts = []
    for shape in link.visuals:
        mesh = _shape_mesh(shape)
        mesh.merge_vertices()
        mesh.apply_transform(shape.X_link_shape)
        parts.append(mesh if cell is None else cluster_vertices(mesh, cell))
    if not parts:
        return None
    vertices = np.concatenate([part.vertices for part in parts])
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)])
    return trimesh.Trimesh(vertices, faces, process=False)


def _shape_mesh(shape: Shape) -> trimesh.Trimesh:
    """The mesh of a shape in its own frame [m]."""
    match shape.kind:
        case "box":
            return trimesh.creation.box(shape.size)
        case "cylinder":
            return trimesh.creation.cylinder(shape.size[0], shape.size[1])
        case "sphere":
            return trimesh.creation.icosphere(radius=shape.size[0])
    try:
        mesh: trimesh.Trimesh = trimesh.load_mesh(shape.mesh)
    except (OSError, ValueError) as error:
        raise AssetError(f"cannot read the mesh {shape.mesh}: {words_of(error)}; put the model's files back") from error
    mesh.vertices *= shape.scale
    return mesh
