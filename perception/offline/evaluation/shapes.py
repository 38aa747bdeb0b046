"""Shapes of end effectors for the metrics: vertices, and whether a view shows the spin."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.perception.offline.dataset.catalogue import Catalogue
from toolee_robot.perception.offline.dataset.instances import ee_mesh
from toolee_robot.perception.offline.evaluation.records import Case, Instance

_VERTICES = 400


@dataclass(frozen=True, eq=False)
class EeShape:
    """Shape of an EE, in its frame.

    Attributes:
        vertices: (V, 3) [m].
        low: Lower corner of their box, (3,) [m].
        high: Upper corner, (3,) [m].
        diameter: Largest distance of two vertices [m].
    """

    vertices: Array
    low: Array
    high: Array
    diameter: float


@lru_cache(maxsize=4096)
def ee_shape(catalogue: Catalogue, tool: int, ee: int) -> EeShape:
    """Shape of one end of a tool.

    Args:
        catalogue: Tools of the data set.
        tool: Number of the tool.
        ee: Index of the end.

    Returns:
        The shape, of at most 400 vertices.
    """
    vertices = 1e-3 * np.asarray(ee_mesh(catalogue.tool(tool), ee).vertices)
    if len(vertices) > _VERTICES:
        vertices = vertices[np.random.default_rng(0).permutation(len(vertices))[:_VERTICES]]
    return EeShape(vertices, vertices.min(0), vertices.max(0), float(pdist(vertices).max()))


def spin_points(instance: Instance, case: Case) -> int:
    """Number of points on parts that show the spin, `EndEffectorSpec.spin_cues`.

    Args:
        instance: The EE with its true pose.
        case: A mask of it, with its cloud.

    Returns:
        The number of such points of the cloud.
    """
    tree, tells = _labelled_surface(instance.catalogue, instance.tool, instance.category.spec.spin_cues)
    X_tool_ee = instance.catalogue.tool(instance.tool).ees[instance.ee].X_tool_ee
    X_tool_camera = X_tool_ee @ inverse(instance.X_camera_ee)
    nearest = tree.query(transform_points(X_tool_camera, case.cloud.points))[1]
    return int(np.count_nonzero(tells[nearest]))


@lru_cache(maxsize=512)
def _labelled_surface(catalogue: Catalogue, number: int, cues: tuple[str, ...]) -> tuple[cKDTree, Array]:
    tool = catalogue.tool(number)
    points, _, parts = tool.sample_surface(6000, np.random.default_rng(0))
    tells = np.array([part.label in cues for part in tool.parts])[parts]
    return cKDTree(points), tells
