"""Mass, centre of mass and inertia of homogeneous solids."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import trimesh

from toolee_robot.frames import Array


def mass_properties(bodies: Iterable[tuple[trimesh.Trimesh, float]]) -> tuple[float, Array, Array]:
    """Mass properties of a set of homogeneous bodies.

    Args:
        bodies: Closed, outward-oriented meshes [m], each with its density [kg/m^3].

    Returns:
        Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m^2], in the axes of the meshes.
    """
    mass, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for mesh, density in bodies:
        m, c, S = _moments(mesh)
        mass += density * m
        first += density * c
        second += density * S
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
