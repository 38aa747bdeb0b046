"""What a tracer of rays is, and what rays hit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.render.device import DeviceArray
from toolee_robot.render.mesh import FloatArray, Mesh


@dataclass(frozen=True, eq=False)
class Found:
    """What N rays hit first. values (6, N) float32: distance in lengths of the ray's direction, 0 where nothing is hit;
    the geometric normal, of any length, on either side; u, v, barycentric, of the face's second and third corner. ids
    (2, N) int32: the face, numbered in its mesh, and the mesh, -1 for none, where the rest is undefined."""

    values: DeviceArray
    ids: DeviceArray


class Tracer(Protocol):
    """Meshes on a device that rays are shot at."""

    def closest(self, rays: DeviceArray) -> Found:
        """What rays (3, N) from the origin hit."""

    def blocked(self, origins: DeviceArray, directions: DeviceArray, reach: DeviceArray) -> DeviceArray:
        """(N,) uint8, 1 where anything is met between origins (3, N) and origins + reach (N,) * directions (3, N).
        Undefined where reach is negative."""


def in_camera(mesh: Mesh, X_camera_body: Array) -> FloatArray:
    """Vertices (V, 3), camera frame: in float64, then rounded once, for a millimetre-exact depth must survive far-away
    world origins."""
    vertices = mesh.vertices.astype(np.float64) @ X_camera_body[:3, :3].T + X_camera_body[:3, 3]
    return np.asarray(vertices, np.float32)
