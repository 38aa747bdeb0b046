"""Meshes for Mitsuba: corners in the world frame with their normals, and texture coordinates by box projection."""

from __future__ import annotations

from typing import Any

import numpy as np

from toolee_robot.render.mesh import FloatArray, Mesh
from toolee_robot.render.path_tracing.library import mitsuba
from toolee_robot.render.scene import Body

_ENDLESS = 6.0
"""Side from which a flat square is a floor, wall or ceiling [m]."""


def mitsuba_mesh(name: str, body: Body, bsdf: Any, texture_size: float, along: int) -> Any:
    """Build a shape.

    Args:
        name: Its id.
        body: The body.
        bsdf: Its material, loaded.
        texture_size: What a texture's side covers [m].
        along: Body axis (0, 1, 2) along which a texture's v runs, where the surface allows.

    Returns:
        A `mitsuba.Mesh`.
    """
    mi = mitsuba()
    R, p = body.X_world_body[:3, :3], body.X_world_body[:3, 3]
    corners = body.mesh.vertices[body.mesh.faces].astype(np.float64)
    count = len(corners)
    properties = mi.Properties()
    properties["mesh_bsdf"] = bsdf
    properties.set_id(name)
    mesh = mi.Mesh(name, 3 * count, count, has_vertex_normals=True, has_vertex_texcoords=True, props=properties)
    parameters = mi.traverse(mesh)
    flat = {
        "vertex_positions": corners.reshape(-1, 3) @ R.T + p,
        "vertex_normals": body.mesh.corner_normals.reshape(-1, 3).astype(np.float64) @ R.T,
        "vertex_texcoords": box_projection(body.mesh, along) / texture_size + np.asarray(body.material.offset)[:2],
    }
    for key, values in flat.items():
        parameters[key] = np.ascontiguousarray(values, np.float32).reshape(-1)
    parameters["faces"] = np.arange(3 * count, dtype=np.uint32)
    parameters.update()
    return mesh


def box_projection(mesh: Mesh, along: int) -> FloatArray:
    """Texture coordinates: each face is projected along the body axis that its normal is nearest to.

    Args:
        mesh: The mesh.
        along: Body axis that becomes v, where the face is not across it.

    Returns:
        Coordinates of the corners, (3 F, 2) [m].
    """
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    across = np.abs(normals).argmax(axis=1)
    others = np.array([[1, 2], [0, 2], [0, 1]])[across]
    others = np.where(others[:, :1] == along, others[:, ::-1], others)  # v is the axis, if it is one of the two
    return np.take_along_axis(corners, others[:, None, :], axis=2).reshape(-1, 2)


def is_endless(body: Body) -> bool:
    """Whether a body is a floor, wall or ceiling: a flat square of 6 m and more."""
    return len(body.mesh.faces) == 2 and float(np.ptp(body.mesh.vertices, axis=0).max()) >= _ENDLESS
