"""Interface of the ray tracers, and the record of hits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.render.device import DeviceArray
from toolee_robot.render.mesh import FloatArray, Mesh


@dataclass(frozen=True, eq=False)
class Found:
    """The first hits of N rays.

    Attributes:
        values: (6, N) float32: distance in lengths of the ray's direction, 0 where nothing is hit; the geometric
            normal, of any length, on either side; barycentric coordinates u, v of the face's second and third corner.
        ids: (2, N) int32: index of the face in its mesh, and of the mesh; -1 where nothing is hit, and the other rows
            are undefined there.
    """

    values: DeviceArray
    ids: DeviceArray


class Tracer(Protocol):
    """Meshes on a device that rays are cast at; camera frame."""

    def closest(self, rays: DeviceArray) -> Found:
        """Find the first hits of rays from the origin.

        Args:
            rays: Directions, (3, N).

        Returns:
            The hits.
        """

    def blocked(self, origins: DeviceArray, directions: DeviceArray, reach: DeviceArray) -> DeviceArray:
        """Check whether anything lies between points and other points, origins + reach * directions.

        Args:
            origins: Origins of the rays, (3, N) [m].
            directions: Directions of the rays, (3, N).
            reach: Lengths of the rays in lengths of their directions, (N,).

        Returns:
            1 where something is hit, else 0, (N,) uint8; undefined where the reach is negative.
        """


def in_camera(mesh: Mesh, X_camera_body: Array) -> FloatArray:
    """Vertices of a mesh in the camera frame.

    They are computed in float64 and rounded once, so that depth stays exact to a millimetre for far-away world origins.

    Args:
        mesh: The mesh.
        X_camera_body: Its pose, (4, 4).

    Returns:
        The vertices, (V, 3) [m].
    """
    vertices = mesh.vertices.astype(np.float64) @ X_camera_body[:3, :3].T + X_camera_body[:3, 3]
    return np.asarray(vertices, np.float32)
