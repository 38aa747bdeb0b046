"""pybullet without its output on the standard streams, meshes shrunk by its collision margin, steps during a strike.

A strike lasts 2 to 5 ms and moves the nail by 2 mm. Compared with the energy balance (free heads of 0.4 to 1 kg at 1 to
4 m/s, tests/sim_backend/physics/test_nail.py), the nail's travel is 0.4 % off at most at 1/4000 s with 100 iterations,
and 4 % at 1/240 s. The engine's correction of penetrations (contactERP, 0.2 by default) would add up to 15 % of energy
to eccentric strikes: it is off.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection

from toolee_robot.frames import Array


@contextmanager
def quiet(descriptor: int) -> Iterator[None]:
    """Discard output to a file descriptor, including that of C libraries.

    Args:
        descriptor: 1 for standard output, 2 for standard error.
    """
    (sys.stdout if descriptor == 1 else sys.stderr).flush()
    c_library = ctypes.CDLL(None)  # C streams have their own buffers
    c_library.fflush(None)
    kept = os.dup(descriptor)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, descriptor)
        yield
    finally:
        c_library.fflush(None)
        os.dup2(kept, descriptor)
        os.close(kept)
        os.close(nowhere)


with quiet(2):
    import pybullet as pb

__all__ = ["pb", "pose_matrix", "quiet", "rotation_matrix"]


def rotation_matrix(quaternion: tuple[float, ...]) -> Array:
    """Rotation matrix (3, 3) of a quaternion (x, y, z, w)."""
    return np.array(pb.getMatrixFromQuaternion(quaternion)).reshape(3, 3)


def pose_matrix(position: tuple[float, ...], quaternion: tuple[float, ...]) -> Array:
    """Build a pose from what pybullet reports.

    Args:
        position: Position [m].
        quaternion: Orientation (x, y, z, w).

    Returns:
        The pose, (4, 4).
    """
    xx, xy, xz, yx, yy, yz, zx, zy, zz = pb.getMatrixFromQuaternion(quaternion)
    x, y, z = position
    return np.array([[xx, xy, xz, x], [yx, yy, yz, y], [zx, zy, zz, z], [0.0, 0.0, 0.0, 1.0]])


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


RESIDUAL = 1e-10
"""Squared velocity error at which the solver ends its iterations early [rad^2/s^2]. With pybullet's 1e-7 a resting arm
droops by 1e-6 rad."""


@dataclass(frozen=True)
class StepSettings:
    """Settings of the physics engine.

    Attributes:
        time_step: Length of a step [s].
        iterations: Solver iterations per step.
        contact_erp: Fraction of a penetration that is corrected per step.
    """

    time_step: float
    iterations: int
    contact_erp: float

    def apply(self, client: int) -> None:
        """Apply the settings to a physics client."""
        pb.setPhysicsEngineParameter(
            fixedTimeStep=self.time_step,
            numSolverIterations=self.iterations,
            contactERP=self.contact_erp,
            numSubSteps=0,
            solverResidualThreshold=RESIDUAL,
            physicsClientId=client,
        )


IMPACT = StepSettings(time_step=1 / 4000, iterations=100, contact_erp=0.0)
