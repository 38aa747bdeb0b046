"""The end effectors of a data set for the evaluation: true poses, and clouds under true or predicted masks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import AssetError
from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.perception.cloud import EeCloud, ee_cloud
from toolee_robot.perception.detection.instances import mask_iou
from toolee_robot.perception.offline.dataset.catalogue import Catalogue
from toolee_robot.perception.offline.dataset.instances import ee_mesh, object_of
from toolee_robot.perception.offline.dataset.records import MIN_POINTS, SCENES, EeTable, read_json
from toolee_robot.perception.offline.dataset.scenes import load_scenes, scene_folders
from toolee_robot.perception.offline.dataset.spec import catalogue_of
from toolee_robot.perception.pipeline import EeDetector
from toolee_robot.types import CameraIntrinsics, Detection, RgbdFrame


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
        tool_score: Detector's score of the tool.
        overlap: Largest IoU of the mask with an EE of its category, matched or not.
    """

    instance: int | None
    image: int
    category: Category
    score: float
    cloud: EeCloud
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


_NOTHING = Case(None, -1, Category.HAMMER_HEAD, -1.0, EeCloud.refused(""))


_VERTICES = 400


@dataclass(frozen=True, eq=False)
class EeShape:
    """Shape of an EE, in its frame.

    Attributes:
        low: Lower corner of the box around it, (3,) [m].
        high: Upper corner, (3,) [m].
        diameter: Largest distance of two points [m].
    """

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
        The shape, by at most 400 of its vertices.
    """
    vertices = 1e-3 * np.asarray(ee_mesh(catalogue.tool(tool), ee).vertices)
    if len(vertices) > _VERTICES:
        vertices = vertices[np.random.default_rng(0).permutation(len(vertices))[:_VERTICES]]
    return EeShape(vertices.min(0), vertices.max(0), float(pdist(vertices).max()))


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


SPLITS = ("test", "train")
MATCH_IOU = 0.5
"""Least IoU of a predicted mask with the EE that it is matched to."""


@dataclass(frozen=True)
class Part:
    """The first images of a scene's folder.

    Attributes:
        scene: The folder.
        catalogue: Tools of the data set.
        count: Number of images.
    """

    scene: Path
    catalogue: Catalogue
    count: int


def parts(folder: Path, limit: int | None = None) -> list[Part]:
    """The parts of a data set, or of one split's folder.

    Args:
        folder: Folder of the data set or split.
        limit: Largest number of images per split; None: all.

    Returns:
        One part per scene.

    Raises:
        AssetError: There is no data set.
    """
    catalogue = catalogue_of(folder)
    found = []
    for scenes in _splits(folder):
        left = limit
        for scene in scenes:
            count = len(read_json(scene / "scene_camera.json"))
            if left is not None:
                count = min(count, left)
                left -= count
            if count:
                found.append(Part(scene, catalogue, count))
    return found


def read_part(part: Part, detector: EeDetector | None) -> Examples:
    """Read the examples of a part, numbered from 0.

    Args:
        part: The part.
        detector: Gives the predicted masks; None: true masks only.

    Returns:
        The examples.

    Raises:
        AssetError: A file is missing or damaged.
    """
    cases: dict[str, list[Case]] = {"truth": []}
    if detector is not None:
        cases["predicted"] = []
    found = Examples([], cases, [], part.count)
    data = load_scenes([part.scene], limit=part.count, threads=2)
    for i in range(len(data)):
        frame = data.frame(i)
        _add(found, i, frame, data.ee[i], data.tool[i], data.row(i), part.catalogue, SCENES[data.scene[i]], detector)
        if SCENES[data.scene[i]] == "empty":
            found.empty.append(frame)
    return found


def of_role(examples: Examples, role: str) -> Examples:
    """Ask for the held-out tools of one role only; the others are neither found nor missed.

    Args:
        examples: The examples.
        role: "validation" or "test".

    Returns:
        The examples with fewer targets.
    """
    kept = [
        i if i.role in ("train", role) else replace(i, target=False, too_few_points=False) for i in examples.instances
    ]
    return replace(examples, instances=kept)


def joined(examples: Iterable[Examples]) -> Examples:
    """Join examples, numbered consecutively."""
    instances: list[Instance] = []
    cases: dict[str, list[Case]] = {}
    empty: list[RgbdFrame] = []
    images = 0
    for more in examples:
        before = len(instances)
        instances += [replace(i, image=i.image + images) for i in more.instances]
        for masks, found in more.cases.items():
            cases.setdefault(masks, []).extend(
                replace(c, image=c.image + images, instance=None if c.instance is None else c.instance + before)
                for c in found
            )
        empty += more.empty
        images += more.images
    return Examples(instances, cases, empty, images)


def collect(folder: Path, detector: EeDetector | None = None, limit: int | None = None) -> Examples:
    """Read a data set or one split's folder.

    One scene is in memory at a time; only clouds and frames without tools are kept.

    Args:
        folder: Folder of the data set or split.
        detector: Gives the predicted masks; None: true masks only.
        limit: Largest number of images per split; None: all.

    Returns:
        The examples.

    Raises:
        AssetError: A file is missing or damaged.
    """
    return joined(read_part(part, detector) for part in parts(folder, limit))


def instances_of(
    image: int, table: EeTable, intrinsics: CameraIntrinsics, catalogue: Catalogue, scene: str
) -> Iterator[tuple[int, Instance]]:
    """The EEs of one image.

    Args:
        image: Number of the image.
        table: Its record.
        intrinsics: Its camera.
        catalogue: Tools of the data set.
        scene: Kind of scene.

    Yields:
        The id in the id maps, and the instance.
    """
    for row in np.flatnonzero(table.category):
        X_hand = table.X_camera_hand[row].astype(np.float64)
        held = bool(np.isfinite(X_hand).all()) and not table.mirrored[row]
        tool, ee = object_of(int(table.obj_id[row]))
        yield (
            int(row) + 1,
            Instance(
                image=image,
                category=CATEGORIES[table.category[row] - 1],
                catalogue=catalogue,
                tool=tool,
                ee=ee,
                X_camera_ee=table.X_camera_ee[row].astype(np.float64),
                X_camera_hand=X_hand if held else None,
                intrinsics=intrinsics,
                visible=int(table.visible[row]),
                occlusion=float(table.occlusion[row]),
                target=bool(table.targets[row]),
                scene=scene,
            ),
        )


def _add(
    found: Examples,
    image: int,
    frame: RgbdFrame,
    ee: NDArray[np.uint8],
    tool: NDArray[np.uint8],
    table: EeTable,
    catalogue: Catalogue,
    scene: str,
    detector: EeDetector | None,
) -> None:
    here: dict[int, NDArray[np.bool_]] = {}
    for ee_id, instance in instances_of(image, table, frame.intrinsics, catalogue, scene):
        number = len(found.instances)
        mask = ee == ee_id
        if np.count_nonzero(frame.depth[mask] > 0) < MIN_POINTS:
            instance = replace(instance, target=False, too_few_points=instance.target)
        found.instances.append(instance)
        here[number] = mask
        if instance.target:
            detection = Detection(
                instance.category, 1.0, mask, (0.0, 0.0, 0.0, 0.0), tool == table.tool[ee_id - 1], 1.0
            )
            found.cases["truth"].append(_case(number, image, frame, detection))
    if detector is None:
        return
    taken: set[int] = set()
    for detection in detector.detect(frame):
        overlaps = {
            n: mask_iou(mask, detection.mask)
            for n, mask in here.items()
            if found.instances[n].category == detection.category
        }
        best = max(overlaps.keys() - taken, key=lambda n: overlaps[n], default=None)
        if best is not None and overlaps[best] < MATCH_IOU:
            best = None
        if best is not None:
            taken.add(best)
        found.cases["predicted"].append(_case(best, image, frame, detection, max(overlaps.values(), default=0.0)))


def _case(instance: int | None, image: int, frame: RgbdFrame, detection: Detection, overlap: float = 1.0) -> Case:
    score, tool_score = detection.score, detection.tool_score
    return Case(instance, image, detection.category, score, ee_cloud(frame, detection), tool_score, overlap)


def _splits(folder: Path) -> list[list[Path]]:
    """The scenes of each split of a data set, or of the one split whose folder is given."""
    splits = [scene_folders(folder / name) for name in SPLITS]
    if not any(splits):
        splits = [scene_folders(folder)]
    if not any(splits):
        raise AssetError(
            f"no BOP scene in {folder}: give the folder of a data set made by `toolee dataset generate`",
            code="asset.no_scene",
        )
    return splits
