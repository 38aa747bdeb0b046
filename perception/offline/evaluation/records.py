"""Records of the evaluation: true instances with their shapes, masks with their clouds, contents of a data set."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.perception.cloud import EeCloud
from toolee_robot.perception.offline.dataset.catalogue import Catalogue
from toolee_robot.perception.offline.dataset.instances import ee_mesh
from toolee_robot.types import CameraIntrinsics, RgbdFrame


@dataclass(frozen=True, eq=False)
class Instance:
    """One EE in one image.

    Attributes:
        image: Number of the image in this evaluation.
        category: Its category.
        catalogue: Tools of the data set.
        tool: Number of its tool in the catalogue.
        ee: Index of the end of its tool.
        X_camera_ee: True pose, 4x4.
        X_camera_hand: Pose of the right hand that holds the tool, 4x4, or None.
        intrinsics: The camera.
        visible: Visible pixels [px].
        occlusion: In [0, 1].
        target: Whether its pose is asked for; one with under 50 points is neither found nor missed.
        first_end: Whether no earlier end of its tool has its category.
        scene: Kind of scene, one of `dataset.records.SCENES`.
        too_few_points: Whether it would be a target but for these 50 points.
    """

    image: int
    category: Category
    catalogue: Catalogue
    tool: int
    ee: int
    X_camera_ee: Array
    X_camera_hand: Array | None
    intrinsics: CameraIntrinsics
    visible: int
    occlusion: float
    target: bool
    first_end: bool
    scene: str
    too_few_points: bool = False

    @property
    def held_out(self) -> bool:
        """Whether the tool is one that training never shows."""
        return self.catalogue.split(self.tool) == "test"

    @property
    def role(self) -> str:
        """Use of the tool: "train", "validation" or "test"."""
        return self.catalogue.role(self.tool)


@dataclass(frozen=True, eq=False)
class Case:
    """One mask with the cloud under it.

    Attributes:
        instance: Index of the instance that it shows; None for a false alarm.
        image: Number of the image.
        category: Claimed category.
        score: Detector's score; 1 for true masks.
        cloud: The EE's cloud.
        tool_points: Points of the whole tool, (N, 3) [m], camera frame.
        tool_score: Detector's score of the tool.
        overlap: Largest IoU of the mask with an EE of its category, matched or not.
    """

    instance: int | None
    image: int
    category: Category
    score: float
    cloud: EeCloud
    tool_points: Array
    tool_score: float = 1.0
    overlap: float = 1.0


@dataclass(frozen=True, eq=False)
class Examples:
    """The contents of a data set.

    Attributes:
        instances: All instances.
        cases: By kind of mask: "truth" and, with a detector, "predicted".
        empty: Frames without any tool.
        images: Number of images.
    """

    instances: list[Instance]
    cases: dict[str, list[Case]]
    empty: list[RgbdFrame]
    images: int

    def of(self, masks: str) -> dict[int, Case]:
        """The best case of each instance, by its index, for one kind of mask."""
        best: dict[int, Case] = {}
        for case in self.cases[masks]:
            if case.instance is not None and case.score > best.get(case.instance, _NOTHING).score:
                best[case.instance] = case
        return best


_NOTHING = Case(None, -1, Category.HAMMER_HEAD, -1.0, EeCloud.refused(""), np.empty((0, 3)))


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
