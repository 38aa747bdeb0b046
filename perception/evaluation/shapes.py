"""What the metrics need to know of a tool: the vertices of its EE, and whether a view tells its spin."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.perception.dataset.catalogue import Catalogue
from toolee_robot.perception.dataset.instances import ee_mesh
from toolee_robot.perception.evaluation.examples import Case, Instance
from toolee_robot.perception.pose.training.losses import SPIN_PIXELS

_VERTICES = 400


@dataclass(frozen=True, eq=False)
class EeShape:
    """vertices (V, 3) [m], EE frame; low, high (3,): their box; diameter [m]."""

    vertices: Array
    low: Array
    high: Array
    diameter: float


@lru_cache(maxsize=4096)
def ee_shape(catalogue: Catalogue, tool: int, ee: int) -> EeShape:
    """The surface of one end of a tool of the data set."""
    vertices = 1e-3 * np.asarray(ee_mesh(catalogue.tool(tool), ee).vertices)
    if len(vertices) > _VERTICES:
        vertices = vertices[np.random.default_rng(0).permutation(len(vertices))[:_VERTICES]]
    return EeShape(vertices, vertices.min(0), vertices.max(0), float(pdist(vertices).max()))


def spin_is_observable(instance: Instance, case: Case) -> bool:
    """Whether the view holds what tells the spin about a free axis, by the rule that training labels with: enough
    points of such parts in the cloud, or the rest of the tool in sight off the axis."""
    if not instance.category.spec.spin_cues:
        return False
    z = instance.X_camera_ee[:3, 2]
    if case.cloud.direction is not None and float(np.linalg.norm(np.cross(case.cloud.direction, z))) > 0.3:
        return True
    return spin_points(instance, case) >= SPIN_PIXELS


def spin_points(instance: Instance, case: Case) -> int:
    """How many points of the cloud are of parts that tell the spin about a free axis, `EndEffectorSpec.spin_cues`."""
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
