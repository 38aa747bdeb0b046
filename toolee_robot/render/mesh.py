"""Triangle meshes of the renderer: float32, with corner normals that preserve creases."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from toolee_robot.frames import Array

FloatArray = NDArray[np.float32]
IntArray = NDArray[np.int32]
_MAX_PARTNERS = 48
"""Maximum number of corners at a vertex that contribute to a normal; only the tips of fans have more."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: Vertices (V, 3) [m], body frame.
        faces: Vertex indices (F, 3), counter-clockwise seen from outside.
        corner_normals: Unit normals of the corners (F, 3, 3), body frame.
        lasting: Whether many scenes use the mesh, so that derived data is cached.
    """

    vertices: FloatArray
    faces: NDArray[np.int32]
    corner_normals: FloatArray
    lasting: bool = False

    @staticmethod
    def build(vertices: object, faces: object, crease_deg: float = 35.0) -> Mesh:
        """Build a lasting mesh with smoothed normals.

        Vertices that coincide to 1 um share their normals even if they are stored separately, as in STL files.

        Args:
            vertices: Vertices (V, 3) [m], body frame.
            faces: Vertex indices (F, 3), counter-clockwise seen from outside.
            crease_deg: Maximum angle [deg] between smoothed faces.

        Returns:
            The mesh.

        Raises:
            ValueError: Vertices are not finite or faces refer to missing vertices.
        """
        v = np.ascontiguousarray(np.asarray(vertices, dtype=np.float32).reshape(-1, 3))
        f = np.ascontiguousarray(np.asarray(faces, dtype=np.int32).reshape(-1, 3))
        if not np.all(np.isfinite(v)) or (f.size and (f.min() < 0 or f.max() >= len(v))):
            raise ValueError("mesh has non-finite vertices or faces that point outside of them")
        return Mesh(v, f, corner_normals(v, f, crease_deg), True)

    def mirrored(self) -> Mesh:
        """The mesh mirrored at x = 0 with outward winding; it turns a link of a right hand into that of a left hand."""
        flip = np.array([-1.0, 1.0, 1.0], np.float32)
        order = [0, 2, 1]
        return Mesh(
            np.ascontiguousarray(self.vertices * flip),
            np.ascontiguousarray(self.faces[:, order]),
            np.ascontiguousarray(self.corner_normals[:, order] * flip),
            self.lasting,
        )

    def scaled(self, factor: float) -> Mesh:
        """The mesh scaled uniformly about its origin."""
        return Mesh(np.ascontiguousarray(self.vertices * np.float32(factor)), self.faces, self.corner_normals)


def corner_normals(vertices: FloatArray, faces: NDArray[np.int32], crease_deg: float) -> FloatArray:
    """Normals at the corners of faces: area-weighted means over the faces at a vertex.

    Args:
        vertices: Vertices, (V, 3) [m].
        faces: Indices of each triangle's vertices, (F, 3).
        crease_deg: Largest angle to the corner's own face of the faces that count [deg].

    Returns:
        Unit normals, (F, 3, 3).
    """
    if len(faces) == 0:
        return np.zeros((0, 3, 3), np.float32)
    (ax, ay, az), (bx, by, bz) = (vertices[faces[:, k]].T - vertices[faces[:, 0]].T for k in (1, 2))
    area_normals = np.column_stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
    unit = area_normals / np.maximum(_lengths(area_normals), 1e-20)
    vertex = _merged(vertices, faces).reshape(-1)  # of each corner
    # Sorted by vertex, a corner's partners (the corners at its vertex, itself included) are neighbours.
    order = np.argsort(vertex, kind="stable")
    face = (order // 3).astype(np.int32)
    counts = np.bincount(vertex)
    first = (np.cumsum(counts) - counts)[vertex[order]]
    partners = np.minimum(counts, _MAX_PARTNERS)[vertex[order]]
    ends = np.cumsum(partners)
    # All pairs of a corner and its partner, as rows and columns of a sparse matrix: 1 where the two faces are smooth.
    partner = face.take(np.arange(ends[-1]) + np.repeat(first - ends + partners, partners))
    own_unit = unit.take(face, axis=0)
    cosine = np.einsum("ij,ij->i", unit.take(partner, axis=0), np.repeat(own_unit, partners, axis=0))
    smooth = (cosine > np.cos(np.deg2rad(crease_deg))).astype(np.float32)
    rows = np.concatenate([[0], ends])
    total = csr_array((smooth, partner, rows), shape=(len(order), len(faces))) @ area_normals
    length = _lengths(total)
    out = np.empty((len(order), 3), np.float32)
    out[order] = np.where(length > 1e-20, total / np.maximum(length, 1e-20), own_unit)
    return out.reshape(-1, 3, 3)


def _lengths(vectors: FloatArray) -> FloatArray:
    """Lengths (N, 1) of vectors (N, 3); np.linalg.norm is several times slower for rows this short."""
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z)[:, None])


def _merged(vertices: FloatArray, faces: NDArray[np.int32]) -> NDArray[np.int64]:
    """Indices (F, 3) of the distinct vertices of faces; vertices that coincide to 1 um share an index."""
    used = np.zeros(len(vertices), np.bool_)
    used[faces] = True
    x, y, z = np.round(vertices[used].T.astype(np.float64) * 1e6)
    order = np.lexsort((x, y, z))
    x, y, z = x[order], y[order], z[order]
    number = np.zeros(len(order), np.int64)
    number[order[1:]] = np.cumsum((x[1:] != x[:-1]) | (y[1:] != y[:-1]) | (z[1:] != z[:-1]))
    of_vertex = np.zeros(len(vertices), np.int64)
    of_vertex[used] = number
    return of_vertex[faces]


_BOX_CORNERS: FloatArray = np.array(
    [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)], np.float32
)
_BOX_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    np.int32,
)  # fmt: skip
_SQUARE = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]], np.float32)
_SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


@lru_cache(maxsize=2)
def _flat_normals(what: str) -> FloatArray:
    """Corner normals of a box or a square, the same for all sizes."""
    vertices, faces = (_BOX_CORNERS, _BOX_FACES) if what == "box" else (_SQUARE, _SQUARE_FACES)
    return corner_normals(vertices, faces, 35.0)


def box(size: tuple[float, float, float] | Array) -> Mesh:
    """Axis-aligned box of the given side lengths [m], centred on the origin."""
    return Mesh(_BOX_CORNERS * np.asarray(size, np.float32), _BOX_FACES, _flat_normals("box"))


def plane(size: float) -> Mesh:
    """Square in z = 0 facing +z, side `size` [m]."""
    return Mesh(_SQUARE * np.float32(size), _SQUARE_FACES, _flat_normals("plane"))


def cylinder(radius: float, length: float, sections: int = 24, top_radius: float | None = None) -> Mesh:
    """Build a cylinder or cone frustum along z, centred: smooth sides, flat ends.

    Args:
        radius: Radius at the bottom [m].
        length: Length [m].
        sections: Number of sides.
        top_radius: Radius at the top [m]; None: as at the bottom.

    Returns:
        The mesh [m].
    """
    top = radius if top_radius is None else top_radius
    ring, faces = _ring(sections), _cylinder_faces(sections)
    vertices = np.zeros((2 * sections + 2, 3), np.float32)
    vertices[:sections, :2], vertices[sections : 2 * sections, :2] = radius * ring, top * ring
    vertices[:sections, 2] = vertices[2 * sections, 2] = -length / 2
    vertices[sections : 2 * sections, 2] = vertices[2 * sections + 1, 2] = length / 2
    # The side normals follow the slope of the frustum.
    slope = np.hypot(length, radius - top)
    side = np.empty((sections, 3), np.float32)
    side[:, :2], side[:, 2] = length / slope * ring, (radius - top) / slope
    normals = np.empty((len(faces), 3, 3), np.float32)
    normals[: 2 * sections] = side[_cylinder_sides(sections)]
    normals[2 * sections : 3 * sections], normals[3 * sections :] = (0, 0, -1), (0, 0, 1)
    return Mesh(vertices, faces, normals)


@lru_cache(maxsize=16)
def _ring(sections: int) -> FloatArray:
    """(N, 2) points of the unit circle."""
    angle = 2 * np.pi * np.arange(sections) / sections
    return np.column_stack([np.cos(angle), np.sin(angle)]).astype(np.float32)


@lru_cache(maxsize=16)
def _cylinder_faces(n: int) -> NDArray[np.int32]:
    """Faces (4 n, 3): the sides, then the lower and the upper end."""
    i = np.arange(n)
    j = (i + 1) % n
    low, high = np.full(n, 2 * n), np.full(n, 2 * n + 1)
    sides = [np.column_stack([i, j, j + n]), np.column_stack([i, j + n, i + n])]
    return np.vstack([*sides, np.column_stack([low, j, i]), np.column_stack([high, i + n, j + n])]).astype(np.int32)


@lru_cache(maxsize=16)
def _cylinder_sides(n: int) -> NDArray[np.int32]:
    """Ring indices (2 n, 3) of the corners of the sides."""
    return _cylinder_faces(n)[: 2 * n] % n


def sphere(radius: float, subdivisions: int = 3) -> Mesh:
    """Build an icosphere; its vertices lie on the sphere.

    Args:
        radius: Radius [m].
        subdivisions: How often each triangle of the icosahedron is divided into four.

    Returns:
        The mesh [m].
    """
    return _unit_sphere(subdivisions).scaled(radius)


@lru_cache(maxsize=4)
def _unit_sphere(subdivisions: int) -> Mesh:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    return Mesh.build(ball.vertices, ball.faces, crease_deg=80.0)


def tube(points: Array, radius: float, sections: int = 10) -> Mesh:
    """Build a cable: a round tube along a polyline, ends open.

    Args:
        points: The polyline, (N, 3) [m].
        radius: Radius [m].
        sections: Number of sides.

    Returns:
        The mesh [m].
    """
    p = np.asarray(points, dtype=np.float64)
    tangent = np.gradient(p, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    reference = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    references = np.empty_like(p)
    for k, t in enumerate(tangent):
        reference = reference - (reference @ t) * t
        reference /= math.sqrt(reference @ reference)
        references[k] = reference
    ring = _ring(sections).astype(np.float64)
    around = ring[:, :1] * references[:, None] + ring[:, 1:] * np.cross(tangent, references)[:, None]
    faces = _tube_faces(len(p), sections)
    normals = around.reshape(-1, 3).astype(np.float32)
    vertices = (p[:, None] + radius * around).reshape(-1, 3).astype(np.float32)
    return Mesh(vertices, faces, normals[faces])


@lru_cache(maxsize=16)
def _tube_faces(n: int, sections: int) -> NDArray[np.int32]:
    """Two triangles for each quad between n rings."""
    i = np.arange(sections)
    j = (i + 1) % sections
    base = (np.arange(n - 1) * sections)[:, None]
    quads = [
        np.stack([base + i, base + j, base + sections + j], -1),
        np.stack([base + i, base + sections + j, base + sections + i], -1),
    ]
    return np.vstack([q.reshape(-1, 3) for q in quads]).astype(np.int32)
