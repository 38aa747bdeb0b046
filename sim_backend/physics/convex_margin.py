"""Convex meshes as pybullet really collides them: it grows each by a margin, so they are shrunk by it before.

The loader's margin of 1 mm would make a hammer meet a nail 1 mm early (and a nail measured by touch stand 1 mm too
high). `changeDynamics(collisionMargin=...)` reaches a single shape, but not the parts of a compound one.
"""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection

MARGIN = 0.001  # [m] that pybullet adds to a convex mesh from a URDF
MIN_CORE = 1e-4  # [m] of radius that is left of a part thinner than the margin


def shrink_convex(mesh: trimesh.Trimesh, margin: float = MARGIN) -> trimesh.Trimesh:
    """The convex mesh [m] whose growth by `margin` has the faces of `mesh` where they were; its edges come out rounded.
    A part thinner than twice the margin keeps a core of MIN_CORE."""
    planes = ConvexHull(mesh.vertices).equations  # unit normals n and offsets b: n x + b <= 0 inside
    normals, offsets = planes[:, :3], planes[:, 3]
    # The largest inscribed ball: its centre is inside the shrunk part, its radius limits the shrinking.
    columns = np.hstack([normals, np.ones((len(normals), 1))])
    ball = linprog([0, 0, 0, -1], A_ub=columns, b_ub=-offsets, bounds=[(None, None)] * 3 + [(0, None)])
    center, radius = ball.x[:3], ball.x[3]
    depth = min(margin, radius - min(MIN_CORE, radius / 2))
    shrunk = np.column_stack([normals, offsets + depth])
    corners = HalfspaceIntersection(shrunk, center).intersections
    return trimesh.Trimesh(corners).convex_hull
