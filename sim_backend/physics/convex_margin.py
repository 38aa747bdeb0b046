"""Compensation of pybullet's collision margin: convex meshes are shrunk by the margin that the loader adds.

The margin of 1 mm would make a hammer hit a nail 1 mm early, and a nail measured by touch appear 1 mm too high.
`changeDynamics(collisionMargin=...)` has an effect on a single shape, but not on the parts of a compound one.
"""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection

MARGIN = 0.001  # [m] that pybullet adds to a convex mesh from a URDF
MIN_CORE = 1e-4  # [m] inscribed radius that remains of a part thinner than the margin


def shrink_convex(mesh: trimesh.Trimesh, margin: float = MARGIN) -> trimesh.Trimesh:
    """Shrink a convex mesh so that adding the margin restores its faces; the edges are then rounded.

    Args:
        mesh: Convex mesh [m].
        margin: The margin that pybullet adds [m].

    Returns:
        The shrunk mesh; of a mesh thinner than twice the margin, a core of inscribed radius MIN_CORE remains.
    """
    planes = ConvexHull(mesh.vertices).equations  # unit normals n and offsets b: n x + b <= 0 inside
    normals, offsets = planes[:, :3], planes[:, 3]
    # Largest inscribed ball: its centre lies inside the shrunk mesh, its radius limits the shrinking.
    columns = np.hstack([normals, np.ones((len(normals), 1))])
    ball = linprog([0, 0, 0, -1], A_ub=columns, b_ub=-offsets, bounds=[(None, None)] * 3 + [(0, None)])
    center, radius = ball.x[:3], ball.x[3]
    depth = min(margin, radius - min(MIN_CORE, radius / 2))
    shrunk = np.column_stack([normals, offsets + depth])
    corners = HalfspaceIntersection(shrunk, center).intersections
    return trimesh.Trimesh(corners).convex_hull
