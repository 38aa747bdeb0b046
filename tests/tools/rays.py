"""Exact ray casting against a small mesh, so that the tests do not lean on a renderer."""

from __future__ import annotations

import numpy as np
import trimesh

from toolee_robot.frames import Array


def cast(mesh: trimesh.Trimesh, origin: Array, direction: Array) -> tuple[Array, Array]:
    """Distances (K,) [m], increasing, and face normals (K, 3) of everything the ray meets (Moller-Trumbore)."""
    a, b, c = np.moveaxis(mesh.vertices.view(np.ndarray)[mesh.faces.view(np.ndarray)], 1, 0)
    ab, ac = b - a, c - a
    p = np.cross(direction, ac)
    det = np.einsum("ij,ij->i", ab, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = origin - a
        u = np.einsum("ij,ij->i", s, p) / det
        q = np.cross(s, ab)
        v = q @ direction / det
        t = np.einsum("ij,ij->i", ac, q) / det
        hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 0)
    order = np.argsort(t[hit])
    normals = np.cross(ab, ac)[hit][order]
    return t[hit][order], normals / np.linalg.norm(normals, axis=1, keepdims=True)


def first(mesh: trimesh.Trimesh, origin: Array, direction: Array) -> float:
    """Distance [m] to the first thing the ray meets; infinity if none."""
    t, _ = cast(mesh, origin, direction)
    return float(t[0]) if len(t) else np.inf
