"""Rays against triangles: by embree on the processor, by Warp's own trees on a GPU."""

from __future__ import annotations

from collections.abc import Sequence

from toolee_robot.frames import Array
from toolee_robot.render.mesh import Mesh
from toolee_robot.render.rays.tracer import Tracer


def tracer_of(meshes: Sequence[tuple[Mesh, Array]], device: str) -> Tracer:
    """Build the ray tracer of a device: Embree on the CPU, Warp's trees on a GPU.

    Args:
        meshes: The meshes, each with its X_camera_body, (4, 4).
        device: Warp device.

    Returns:
        The tracer.
    """
    if device == "cpu":
        from toolee_robot.render.rays.embree import EmbreeTracer

        return EmbreeTracer(meshes)
    from toolee_robot.render.rays.bvh import BvhTracer

    return BvhTracer(meshes, device)
