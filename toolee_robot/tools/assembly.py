"""From overlapping pieces to a Tool: parts without overlap, one outer surface, mass properties."""

from __future__ import annotations

import numpy as np
import trimesh

from toolee_robot.frames import Array
from toolee_robot.tools.model import EndEffector, Handle, Part, Tool, ToolKind
from toolee_robot.tools.solids import Piece, to_trimesh, unite


def assemble(
    kind: ToolKind, seed: int, pieces: list[Piece], ees: tuple[EndEffector, ...], handle: Handle
) -> Tool:
    """Where two pieces overlap, the later one keeps the volume (a handle fills the eye of its head)."""
    parts = []
    for i, piece in enumerate(pieces):
        solid = piece.solid
        for later in pieces[i + 1 :]:
            solid = solid - later.solid
        if not solid.is_empty():
            parts.append((i, Part(piece.label, to_trimesh(solid), piece.material)))
    mesh, owner = unite([piece.solid for piece in pieces])
    position = {piece_index: part_index for part_index, (piece_index, _) in enumerate(parts)}
    face_parts = np.array([position[i] for i in range(len(pieces)) if i in position], dtype=np.int64)[
        np.searchsorted([i for i in range(len(pieces)) if i in position], owner)
    ]
    mass, com, inertia = mass_properties(tuple(part for _, part in parts))
    return Tool(
        kind=kind,
        seed=seed,
        parts=tuple(part for _, part in parts),
        mesh=mesh,
        face_parts=face_parts,
        ees=ees,
        handle=handle,
        mass=mass,
        center_of_mass=com,
        inertia=inertia,
        _convex_points=tuple(points for piece in pieces for points in piece.convex),
    )


def mass_properties(parts: tuple[Part, ...]) -> tuple[float, Array, Array]:
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
