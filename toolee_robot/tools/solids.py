"""Solid modelling: lofts through rings, extrusions, booleans with labelled faces.

A loft is a stack of rings, (N, M, 3): N closed sections of M points. Every shape is made along its local z and then
placed with a 4x4 pose.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray

from toolee_robot.frames import Array, transform_points
from toolee_robot.tools.materials import Material


@dataclass(frozen=True, eq=False)
class Convex:
    """A collision shape made of convex hulls.

    Attributes:
        points: Points (K, 3) [m] of one hull or, with a tolerance, the rings (N, M, 3) [m] of a loft.
        tolerance: Largest relative distance of an inner ring to the hull of its run of rings; None: one hull.
    """

    points: Array
    tolerance: float | None = None

    def placed(self, X: Array) -> Convex:
        """The shape transformed by a pose, 4x4."""
        return replace(self, points=move(self.points, X))

    def hulls(self) -> list[Array]:
        """Point sets (K, 3) [m], one for each hull."""
        return [self.points] if self.tolerance is None else _convex_runs(self.points, self.tolerance)


@dataclass(frozen=True, eq=False)
class Piece:
    """A labelled solid before assembly.

    Attributes:
        label: Name of the part.
        solid: manifold3d solid [m].
        material: Its material.
        convex: Its collision shapes.
    """

    label: str
    solid: Any
    material: Material
    convex: tuple[Convex, ...]

    def placed(self, X: Array) -> Piece:
        """The piece transformed by a pose, 4x4."""
        return replace(self, solid=place(self.solid, X), convex=tuple(c.placed(X) for c in self.convex))


def loft_piece(label: str, rings: Array, material: Material, tolerance: float = 0.04) -> Piece:
    """Make a piece of a loft.

    Args:
        label: Name of the piece.
        rings: Sections of the loft, (N, M, 3) [m].
        material: Material of the piece.
        tolerance: As in `Convex`.

    Returns:
        The piece.
    """
    return Piece(label, loft(rings), material, (Convex(rings, tolerance),))


def loft(rings: Array) -> Any:
    """The solid through rings (N, M, 3) of either orientation, closed by flat fans."""
    n, m, _ = rings.shape
    vertices = np.concatenate([rings.reshape(-1, 3), rings[0].mean(0)[None], rings[-1].mean(0)[None]])
    faces = _loft_faces(n, m)
    if signed_volume(vertices, faces) < 0:
        faces = faces[:, ::-1]
    return solid_from(vertices, faces)


@lru_cache(maxsize=256)
def _loft_faces(n: int, m: int) -> NDArray[np.int64]:
    """Faces (F, 3) of a loft of n rings of m points, followed by the centres of the first and the last ring."""
    j = np.arange(m)
    k = (j + 1) % m
    base = (np.arange(n - 1) * m)[:, None]
    lower, upper = (base + j, base + k), (base + m + j, base + m + k)
    sides = np.concatenate(
        [np.stack([lower[0], lower[1], upper[1]], -1), np.stack([lower[0], upper[1], upper[0]], -1)]
    ).reshape(-1, 3)
    bottom, top = n * m, n * m + 1
    caps = [
        np.column_stack([np.full(m, bottom), k, j]),
        np.column_stack([np.full(m, top), (n - 1) * m + j, (n - 1) * m + k]),
    ]
    return np.concatenate([sides, *caps])


def solid_from(vertices: Array, faces: NDArray[np.int64]) -> Any:
    """Make a manifold3d solid of a closed mesh.

    Args:
        vertices: Vertices, (V, 3) [m].
        faces: Indices of each triangle's vertices, (F, 3), counter-clockwise seen from outside.

    Returns:
        The solid.

    Raises:
        ValueError: The mesh is empty or not closed.
    """
    solid = manifold3d.Manifold(
        manifold3d.Mesh(np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(faces, np.uint32))
    )
    if solid.status() != manifold3d.Error.NoError or solid.is_empty():
        raise ValueError(f"not a closed surface: {solid.status()}")
    return solid


def signed_volume(vertices: Array, faces: NDArray[np.int64]) -> float:
    """Enclosed volume of a closed mesh, by the divergence theorem.

    Args:
        vertices: Vertices, (V, 3) [m].
        faces: Indices of each triangle's vertices, (F, 3).

    Returns:
        The volume [m^3]; positive for outward-oriented faces.
    """
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = (vertices[faces[:, i]].T for i in range(3))
    return float((ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)).sum() / 6.0)


def extrude(polygons: Any, z_min: float, z_max: float) -> Any:
    """Extrude a section along z.

    Args:
        polygons: A CrossSection, or one polygon, (M, 2) [m].
        z_min: Lower end [m].
        z_max: Upper end [m].

    Returns:
        The prism.
    """
    if not isinstance(polygons, manifold3d.CrossSection):
        polygons = cross_section(polygons)
    return polygons.extrude(z_max - z_min).translate((0.0, 0.0, z_min))


def cross_section(polygon: Any) -> Any:
    """A planar region from one closed polygon (M, 2) of either orientation."""
    return manifold3d.CrossSection([np.asarray(polygon, dtype=np.float64)], manifold3d.FillRule.NonZero)


def prism_points(polygon: Any, z_min: float, z_max: float) -> Array:
    """Corners of a prism along z.

    Args:
        polygon: The section, (M, 2) [m].
        z_min: Lower end [m].
        z_max: Upper end [m].

    Returns:
        The corners, (2 M, 3) [m], those of the lower end first.
    """
    p = np.asarray(polygon, dtype=np.float64)
    return np.concatenate([np.column_stack([p, np.full(len(p), z)]) for z in (z_min, z_max)])


def place(solid: Any, X: Array) -> Any:
    """Transform a solid.

    Args:
        solid: The solid.
        X: Pose of the solid's frame in the new frame, (4, 4).

    Returns:
        The solid in the new frame.
    """
    return solid.transform(X[:3].tolist())


def move(points: Array, X: Array) -> Array:
    """Transform points.

    Args:
        points: Points, (..., 3) [m].
        X: Pose of the points' frame in the new frame, (4, 4).

    Returns:
        The points in the new frame, (..., 3) [m].
    """
    return transform_points(X, points.reshape(-1, 3)).reshape(points.shape)


def _convex_runs(rings: Array, tolerance: float) -> list[Array]:
    """Split a loft greedily into nearly convex runs of rings; adjacent runs share a ring."""
    sizes = np.linalg.norm(rings - rings.mean(1, keepdims=True), axis=2).max(1)
    runs, start = [], 0
    while start < len(rings) - 1:
        end = start + 1
        while end + 1 < len(rings) and _stays_convex(rings[start : end + 2], sizes[start : end + 2], tolerance):
            end += 1
        runs.append(rings[start : end + 1].reshape(-1, 3))
        start = end
    return runs


def _stays_convex(rings: Array, sizes: Array, tolerance: float) -> bool:
    """Whether each inner ring reaches the lines from the last ring to the rings before it, within the tolerance."""
    centers = rings.mean(1)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centers, axis=0), axis=1) + 1e-12)])
    i, j = np.triu_indices(len(rings) - 1, 1)
    s = ((along[j] - along[i]) / (along[-1] - along[i]))[:, None, None]
    points = rings[:, ::3]
    outward = points[j] - centers[j][:, None]
    outward = outward / np.maximum(np.linalg.norm(outward, axis=2, keepdims=True), 1e-9)
    inside = ((1 - s) * points[i] + s * points[-1] - points[j]) * outward
    return bool(np.all(inside.sum(2) <= tolerance * sizes[j, None]))


def hull(points: Array) -> trimesh.Trimesh:
    """Convex hull of points (K, 3)."""
    return to_trimesh(manifold3d.Manifold.hull_points(np.ascontiguousarray(points, dtype=np.float64)))


def without(solid: Any, others: Iterable[Any]) -> Any:
    """Subtract solids from a solid.

    Args:
        solid: The solid.
        others: What is subtracted; solids whose bounding box does not touch it are skipped.

    Returns:
        The remainder.
    """
    for other in others:
        box, other_box = np.array(solid.bounding_box()), np.array(other.bounding_box())
        if np.all(box[:3] <= other_box[3:]) and np.all(other_box[:3] <= box[3:]):
            solid = solid - other
    return solid


def to_trimesh(solid: Any) -> trimesh.Trimesh:
    """The surface of a manifold3d solid."""
    mesh = solid.to_mesh()
    return trimesh.Trimesh(
        np.asarray(mesh.vert_properties[:, :3], dtype=np.float64), np.asarray(mesh.tri_verts), process=False
    )


def unite(pieces: list[Any]) -> tuple[trimesh.Trimesh, NDArray[np.int64]]:
    """The union of solids, and the index of the source solid of each of its faces (F,)."""
    originals = [piece.as_original() for piece in pieces]
    index = {original.original_id(): i for i, original in enumerate(originals)}
    mesh = manifold3d.Manifold.batch_boolean(originals, manifold3d.OpType.Add).to_mesh()
    faces = np.asarray(mesh.tri_verts)
    owner = np.zeros(len(faces), dtype=np.int64)
    runs = np.asarray(mesh.run_index) // 3
    for run, original_id in enumerate(mesh.run_original_id):
        owner[runs[run] : runs[run + 1]] = index[int(original_id)]
    return trimesh.Trimesh(np.asarray(mesh.vert_properties[:, :3], np.float64), faces, process=False), owner


def superellipse(exponent: float, points: int = 32) -> Array:
    """Unit superellipse |x|^n + |y|^n = 1.

    Args:
        exponent: The exponent n; 2 is a circle, 4 and above a rounded square.
        points: Number of points, M.

    Returns:
        The outline, counter-clockwise, (M, 2).
    """
    t = 2 * np.pi * np.arange(points) / points
    c, s = np.cos(t), np.sin(t)
    return np.column_stack([np.sign(c) * np.abs(c) ** (2 / exponent), np.sign(s) * np.abs(s) ** (2 / exponent)])


def regular_polygon(sides: int, points: int = 32, corner: float = 0.0) -> Array:
    """Regular polygon with inradius 1 and one side normal to x.

    Args:
        sides: Number of sides.
        points: Number of points, M.
        corner: Blend with the unit circle, in [0, 1): 0 keeps the corners sharp.

    Returns:
        The outline, counter-clockwise, (M, 2).
    """
    t = 2 * np.pi * np.arange(points) / points
    half = np.pi / sides
    r = 1.0 / np.cos((t + half) % (2 * half) - half)
    r = (1 - corner) * r + corner
    return r[:, None] * np.column_stack([np.cos(t), np.sin(t)])


def hexagon(flats: float) -> Array:
    """Corners (6, 2) of a hexagon `flats` across, two of its sides normal to y."""
    t = np.arange(6) * np.pi / 3
    return 0.5 * flats / np.cos(np.pi / 6) * np.column_stack([np.cos(t), np.sin(t)])


def lobes(count: int, depth: float, points: int = 48) -> Array:
    """Unit circle with flutes.

    Args:
        count: Number of flutes.
        depth: Depth of a flute as a share of the radius.
        points: Number of points, M.

    Returns:
        The outline, counter-clockwise, (M, 2).
    """
    t = 2 * np.pi * np.arange(points) / points
    r = 1.0 - depth * (0.5 - 0.5 * np.cos(count * t)) ** 2
    return r[:, None] * np.column_stack([np.cos(t), np.sin(t)])


def stack(z: Any, a: Any, b: Any = None, section: Array | None = None, x: Any = 0.0) -> Array:
    """Rings of a loft along z.

    Args:
        z: Heights of the rings (N,) [m].
        a: Half-widths along x, scalar or (N,) [m].
        b: Half-widths along y, scalar or (N,) [m]; `a` if None.
        section: Unit sections, (M, 2) or (N, M, 2); a circle if None.
        x: Centres of the rings along x, scalar or (N,) [m].

    Returns:
        Rings (N, M, 3) [m].
    """
    z = np.asarray(z, dtype=np.float64)
    a = np.broadcast_to(np.asarray(a, dtype=np.float64), z.shape)
    b = a if b is None else np.broadcast_to(np.asarray(b, dtype=np.float64), z.shape)
    x = np.broadcast_to(np.asarray(x, dtype=np.float64), z.shape)
    unit = superellipse(2.0) if section is None else section
    unit = np.broadcast_to(unit, (len(z), *unit.shape[-2:]))
    return np.stack(
        [x[:, None] + a[:, None] * unit[..., 0], b[:, None] * unit[..., 1], np.repeat(z[:, None], unit.shape[1], 1)],
        axis=-1,
    )


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
