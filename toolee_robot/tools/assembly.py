"""From overlapping pieces to a Tool: parts without overlap, one outer surface, mass properties."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from toolee_robot.frames import Array
from toolee_robot.tools.model import EndEffector, Handle, SolidPart, Tool, ToolKind, tool_name
from toolee_robot.tools.solids import Piece, to_trimesh, unite


def assemble(kind: ToolKind, seed: int, pieces: list[Piece], ees: tuple[EndEffector, ...], handle: Handle) -> Tool:
    """Where two pieces overlap, the later one keeps the volume (a handle fills the eye of its head)."""
    kept, parts = [], []
    for i, piece in enumerate(pieces):
        solid = piece.solid
        for later in pieces[i + 1 :]:
            if _boxes_meet(solid, later.solid):
                solid = solid - later.solid
        if not solid.is_empty():
            kept.append(i)
            parts.append(SolidPart(piece.label, piece.material, to_trimesh(solid)))
    mesh, owner = unite([piece.solid for piece in pieces])
    mass, com, inertia = mass_properties(tuple(parts))
    return Tool(
        name=tool_name(kind, seed),
        kind=kind,
        seed=seed,
        parts=tuple(parts),
        mesh=mesh,
        face_parts=np.searchsorted(kept, owner),
        ees=ees,
        handle=handle,
        mass=mass,
        center_of_mass=com,
        inertia=inertia,
        _convex=tuple((piece.label, convex) for piece in pieces for convex in piece.convex),
    )


def _boxes_meet(a: Any, b: Any) -> bool:
    box_a, box_b = np.array(a.bounding_box()), np.array(b.bounding_box())
    return bool(np.all(box_a[:3] <= box_b[3:]) and np.all(box_b[:3] <= box_a[3:]))


def mass_properties(parts: tuple[SolidPart, ...]) -> tuple[float, Array, Array]:
    """Mass [kg], centre of mass (3,) [m] and inertia 3x3 [kg m^2] about it, of homogeneous closed meshes."""
    mass, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for part in parts:
        m, c, S = _moments(part.mesh)
        mass += part.density * m
        first += part.density * c
        second += part.density * S
    com = first / mass
    about_com = second - mass * np.outer(com, com)
    return mass, com, np.trace(about_com) * np.eye(3) - about_com


def _moments(mesh: trimesh.Trimesh) -> tuple[float, Array, Array]:
    """Volume, its first moment (3,) and second moment (3, 3) about the origin, summed over tetrahedra."""
    T = mesh.vertices.view(np.ndarray)[mesh.faces.view(np.ndarray)]
    v = np.einsum("ij,ij->i", T[:, 0], np.cross(T[:, 1], T[:, 2])) / 6.0
    s = T.sum(1)
    first = np.einsum("i,ij->j", v, s) / 4.0
    # Integral of x x^T over a tetrahedron with one corner at the origin: V/20 (sum_i x_i x_i^T + s s^T).
    second = (np.einsum("i,iaj,iak->jk", v, T, T) + np.einsum("i,ij,ik->jk", v, s, s)) / 20.0
    return float(v.sum()), first, second
