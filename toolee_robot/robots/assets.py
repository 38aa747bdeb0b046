"""Files of the models, and the meshes of their links in metres, simplified for rendering."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from toolee_robot.errors import AssetError, words_of
from toolee_robot.robots.tree import Link, Shape

MODELS = Path(__file__).parent / "models"
"""Model files and licences of arms and hands, one folder each."""
UR10_URDF = MODELS / "ur10" / "ur10_robot.urdf"
SHADOW_HAND_URDF = MODELS / "shadow_hand" / "shadow_hand.urdf"
INSPIRE_RH56_URDF = MODELS / "inspire_rh56" / "inspire_rh56.urdf"
ABILITY_HAND_URDF = MODELS / "ability_hand" / "ability_hand.urdf"


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
