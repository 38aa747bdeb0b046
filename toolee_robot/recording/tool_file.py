"""The tool's shape as a file in a recording."""

from __future__ import annotations

import io

import numpy as np
import trimesh

from toolee_robot.tools import ToolShape


def tool_model(shape: ToolShape) -> bytes:
    """A tool's surface as a glTF binary, coloured by part, in the frame `tool`.

    Args:
        shape: The tool.

    Returns:
        The file.
    """
    colors = np.array([[*(round(255 * c) for c in part.material.color), 255] for part in shape.parts], dtype=np.uint8)
    # The faces' corners apart, so that each has its part's colour.
    triangles = shape.mesh.vertices.view(np.ndarray)[shape.mesh.faces.view(np.ndarray)].reshape(-1, 3)
    mesh = trimesh.Trimesh(triangles, np.arange(len(triangles)).reshape(-1, 3), process=False)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.repeat(colors[shape.face_parts], 3, axis=0))
    data = mesh.export(file_type="glb")
    assert isinstance(data, bytes)
    return data


def read_tool_model(data: bytes) -> trimesh.Trimesh:
    """The surface of a tool from its file, frame `tool`.

    Args:
        data: The file.

    Returns:
        The mesh, coloured by vertex.
    """
    return trimesh.load_mesh(io.BytesIO(data), file_type="glb")
