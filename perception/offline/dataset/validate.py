"""Is a data set what it says? Finds files that are missing, broken, changed or that contradict one another."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.errors import AssetError, TooleeError, UserError
from toolee_robot.frames import Array, inverse, is_rigid, transform_points
from toolee_robot.perception.offline.dataset.index_files import COCO, GENERATED_BY, README, Summary, is_finished, listed
from toolee_robot.perception.offline.dataset.instances import MODELS, object_of, read_ply, tool_path
from toolee_robot.perception.offline.dataset.records import (
    CIRCLE,
    HEIGHT,
    SCENES,
    SUMS,
    WIDTH,
    Example,
    back_projected,
    read_clouds,
    read_json,
    read_sums,
)
from toolee_robot.perception.offline.dataset.scenes import SceneWriter, bbox, pose_of, read_image, table_of
from toolee_robot.perception.offline.dataset.spec import SPLITS, DatasetSpec, SceneJob
from toolee_robot.perception.offline.processes import on_processes
from toolee_robot.runtime.files import sha256
from toolee_robot.types import CameraIntrinsics

Problem = tuple[str, str]
"""A file of the scene, and what is wrong with it."""
Mask = NDArray[np.bool_]
_JSON = ("camera", "gt", "gt_info", "gt_coco", "instances")
_CLOUDS = "clouds.npz"


def check_scene(spec: DatasetSpec, root: Path, job: SceneJob) -> Iterator[Problem]:
    """Look for contradictions in one scene: its description must be what its images and poses give.

    Args:
        spec: What the data set was generated from.
        root: Folder of the data set.
        job: The scene.

    Yields:
        File, relative to the scene's folder, and problem.
    """
    folder = job.folder(root)
    data: dict[str, Any] = {}
    for name in _JSON:
        try:
            data[name] = read_json(folder / f"scene_{name}.json")
        except AssetError as error:
            yield f"scene_{name}.json", str(error)
    if len(data) < len(_JSON):
        return
    wanted = {str(i) for i in range(job.last - job.first)}
    for name in ("camera", "gt", "gt_info"):
        if not isinstance(data[name], dict) or set(data[name]) != wanted:
            yield f"scene_{name}.json", f"does not describe images 0 to {len(wanted) - 1}, each once"
            return
    checker = _Checker(spec, root, folder, job.split, data)
    for im_id in range(len(wanted)):
        try:
            yield from checker.image(im_id)
        except (KeyError, TypeError, ValueError, IndexError, UserError) as error:
            yield "scene_gt.json", f"image {im_id}: an entry is missing or malformed ({error!r})"
    yield from checker.derived()


class _Checker:
    """One scene."""

    def __init__(self, spec: DatasetSpec, root: Path, folder: Path, split: str, data: dict[str, Any]) -> None:
        self._root, self._folder, self._split, self._data = root, folder, split, data
        self._catalogue = spec.catalogue(root)
        self._surfaces: dict[str, cKDTree | None] = {}
        self._again: dict[str, bytes] = {}
        self._writer = SceneWriter(self._again.__setitem__, self._catalogue)
        self._complete = True

    def image(self, im_id: int) -> Iterator[Problem]:
        """Everything about one image."""
        camera, gt, info = (self._data[name][str(im_id)] for name in ("camera", "gt", "gt_info"))
        K = camera["cam_K"]
        if len(K) != 9 or not (K[0] > 0 and K[4] > 0) or camera["depth_scale"] != 1.0 or camera["scene"] not in SCENES:
            yield "scene_camera.json", f"image {im_id}: cam_K, depth_scale or scene is impossible"
            return
        if len(gt) != len(info):
            self._complete = False
            yield "scene_gt_info.json", f"image {im_id}: {len(info)} entries for {len(gt)} in scene_gt.json"
            return
        name, read = f"{im_id:06d}", {}
        files = [(f"rgb/{name}.jpg", "uint8", 3), (f"depth/{name}.png", "uint16", 2), (f"tool/{name}.png", "uint8", 2)]
        files += [(f"{kind}/{name}_{k:06d}.png", "bool", 2) for k in range(len(gt)) for kind in ("mask", "mask_visib")]
        for file, dtype, ndim in files:
            try:
                read[file] = read_image(self._folder / file)
                if read[file].dtype != dtype or read[file].ndim != ndim:
                    yield file, f"holds {read[file].dtype} of shape {read[file].shape}"
                    del read[file]
            except AssetError as error:
                yield file, str(error)
        if len(read) < len(files):
            self._complete = False
            return
        rgb, depth, tool, *masks = (read[file] for file, _, _ in files)
        intrinsics = CameraIntrinsics(K[0], K[4], K[2], K[5], WIDTH, HEIGHT)
        table = table_of(gt, info)
        ee, unoccluded = np.zeros((2, HEIGHT, WIDTH), np.uint8)
        for k, (entry, about) in enumerate(zip(gt, info, strict=True)):
            where, full, visible = f"image {im_id}, entry {k}", masks[2 * k], masks[2 * k + 1]
            yield from self._labels(entry, where)
            yield from _masks(full, visible, tool, entry, about, f"{name}_{k:06d}.png")
            fault = self._pose_fault(visible, depth, intrinsics, entry, camera["scene"])
            if fault is not None:
                yield "scene_gt.json", f"{where}: the pose is off the mask: {fault}"
            ee[visible] = k + 1
            unoccluded |= full.astype(np.uint8) << np.uint8(k)
        scene = SCENES.index(camera["scene"])
        self._writer.add(Example(rgb, depth, ee, tool, table, intrinsics, scene, unoccluded))

    def derived(self) -> Iterator[Problem]:
        """Write the description again from images, masks and poses, and compare it."""
        if not self._complete:
            return
        self._writer.close()
        for name in _JSON:
            if json.loads(self._again[f"scene_{name}.json"]) != self._data[name]:
                yield f"scene_{name}.json", "is not what the scene's images, masks and poses give"
        try:
            read_clouds(self._folder)
        except AssetError as error:
            yield _CLOUDS, str(error)
            return
        if self._again[_CLOUDS] != (self._folder / _CLOUDS).read_bytes():
            yield _CLOUDS, "is not what the masks and the depth give"

    def _labels(self, entry: dict[str, Any], where: str) -> Iterator[Problem]:
        """Object, category, split and poses."""
        file = "scene_gt.json"
        try:
            number, ee = object_of(entry["obj_id"])
            end = self._catalogue.tool(number).ees[ee]
            split = self._catalogue.split(number)
        except (UserError, AssetError, IndexError) as error:
            yield file, f"{where}: obj_id {entry['obj_id']} is no end effector ({error})"
            return
        if entry["category_id"] != end.category.spec.class_id:
            yield file, f"{where}: category_id {entry['category_id']}, but object {entry['obj_id']} is a {end.category}"
        if split != self._split:
            yield file, f"{where}: {entry['instance']} belongs to the {split} split"
        X_ee, X_tool = pose_of(entry).astype(np.float64), pose_of(entry, "t2c").astype(np.float64)
        if not (is_rigid(X_ee, 1e-4) and is_rigid(X_tool, 1e-4)):
            yield file, f"{where}: a rotation matrix is not a rotation"
        elif not np.allclose(X_tool @ end.X_tool_ee, X_ee, atol=1e-4):
            yield file, f"{where}: the EE's pose does not fit its tool's"

    def _pose_fault(
        self, visible: Mask, depth: NDArray[np.uint16], K: CameraIntrinsics, entry: dict[str, Any], scene: str
    ) -> str | None:
        """Why the points that the camera sees of the EE do not lie on its tool as the pose places it."""
        points = back_projected(visible, depth, K).astype(np.float64)
        surface = self._surface(entry["instance"])
        X = pose_of(entry, "t2c").astype(np.float64)
        if len(points) < ENOUGH or surface is None or not is_rigid(X, 1e-4):
            return None
        origin = pose_of(entry)[:3, 3].astype(np.float64)
        if scene == "paper":
            aside = points[:, :2] / points[:, 2:] - origin[:2] / origin[2]
            within = np.linalg.norm(aside, axis=1) * K.fx < CIRCLE + 1.0
        else:
            radius = CATEGORIES[entry["category_id"] - 1].spec.radius
            within = np.linalg.norm(points - origin, axis=1) < radius + SURFACE
        return pose_fault(points, within, X, surface, K, is_thin(visible))

    def _surface(self, name: str) -> cKDTree | None:
        if name not in self._surfaces:
            try:
                vertices, faces = read_ply(tool_path(self._root, name))
                mesh = trimesh.Trimesh(1e-3 * vertices, faces, process=False)
                self._surfaces[name] = cKDTree(trimesh.sample.sample_surface(mesh, 6000, seed=0)[0])
            except TooleeError:
                self._surfaces[name] = None  # the checksums tell it
        return self._surfaces[name]


def _masks(
    full: Mask, visible: Mask, tool: NDArray[np.uint8], entry: dict[str, Any], about: dict[str, Any], name: str
) -> Iterator[Problem]:
    """The masks of an EE against what scene_gt_info says of them, and against the tool's."""
    for kind, mask, key in (("mask", full, ("px_count_all", "bbox_obj")), ("mask_visib", visible, _VISIBLE)):
        there = (int(np.count_nonzero(mask)), bbox(mask))
        if there != (about[key[0]], about[key[1]]):
            yield (
                f"{kind}/{name}",
                f"{there[0]} pixels in {there[1]}; scene_gt_info: {about[key[0]]} in {about[key[1]]}",
            )
    if np.any(visible & ~full):
        yield f"mask_visib/{name}", "shows more than mask/ holds"
    if np.any(tool[visible] != entry["tool_id"]):
        yield f"mask_visib/{name}", f"is not on tool {entry['tool_id']}"


_VISIBLE = ("px_count_visib", "bbox_visib")


SURFACE = 0.008
"""Farther [m] from the tool's surface no point is the tool's: noise is 3 mm at most in the median."""
ENOUGH = 100
"""Fewer points than this tell nothing."""
_NEAR = 0.2
"""Share of points within twice `SURFACE` of the tool, but not on it, from which on its depth is in doubt: 2 % of a long
screwdriver's are there, 16 % in the noisiest image."""
_JITTER = 2
"""Most pixels' lateral noise reaches no further [px]."""


def is_thin(mask: NDArray[np.bool_]) -> bool:
    """Whether nearly all of it is within the sensor's jitter of its outline."""
    return int(np.count_nonzero(binary_erosion(mask, iterations=_JITTER))) < ENOUGH


def pose_fault(
    points: Array, within: NDArray[np.bool_], X_camera_tool: Array, surface: cKDTree, K: CameraIntrinsics, thin: bool
) -> str | None:
    """Check the pose of a tool against the measured points of an EE.

    Flying pixels and background may be a third of the points of a thin tool, and half of those of a long screwdriver's
    shaft. So half of the points must lie on the tool; or three tenths, if all others lie behind or before the tool's
    outline, and, unless the mask is thin, far: beside a pose that is off in depth they lie near. Points on the tool
    must be within the EE's reach, unless the EE is so thin that lateral noise shows other parts of the tool.

    Args:
        points: Measured points of the EE's mask, camera frame, (N, 3) [m].
        within: Which of them are within the EE's reach, (N,).
        X_camera_tool: The pose to check, (4, 4).
        surface: Samples of the tool's surface, `tool` frame [m].
        K: Intrinsics of the camera.
        thin: Whether lateral noise affects nearly the whole mask, see `is_thin`.

    Returns:
        What shows that the pose is wrong; None where nothing does.
    """
    distance = surface.query(transform_points(inverse(X_camera_tool), points))[0]
    on_tool = distance < SURFACE
    if (share := on_tool.mean()) < 0.5:
        outlined = _beyond_outline(points, transform_points(X_camera_tool, np.asarray(surface.data)), K)
        far = ((distance >= SURFACE) & (distance < 2 * SURFACE)).mean() < _NEAR
        if not ((thin or far) and share > 0.3 and (on_tool | outlined).mean() > 0.98):
            return f"{share:.0%} of its points are on the tool"
    if (share := within[on_tool].mean()) < (0.5 if thin else 0.9):
        return f"{share:.0%} of its points are in the EE's reach"
    return None


def _beyond_outline(points: Array, surface: Array, K: CameraIntrinsics) -> NDArray[np.bool_]:
    """Which points lie behind or before the surface, within lateral noise of its outline.

    Args:
        points: Points, camera frame, (N, 3) [m].
        surface: Samples of the surface, camera frame, (S, 3) [m].
        K: Intrinsics of the camera.
    """

    def pixels(x: Array) -> Array:
        return np.column_stack([K.fx * x[:, 0], K.fy * x[:, 1]]) / x[:, 2:]

    distance, nearest = cKDTree(pixels(surface)).query(pixels(points))
    return np.asarray((distance <= _JITTER + 0.5) & (np.abs(points[:, 2] - surface[nearest, 2]) > SURFACE))


@dataclass(frozen=True, order=True)
class Fault:
    """A fault of a data set.

    Attributes:
        file: Path of the file in the data set.
        problem: What is wrong with it, for a person.
    """

    file: str
    problem: str


def validate(root: Path, workers: int = 1, progress: Callable[[int, int], None] | None = None) -> list[Fault]:
    """Check a data set; every file is read.

    Args:
        root: Folder of the data set.
        workers: Number of processes.
        progress: Called with the number of examples checked and the number of all.

    Returns:
        The faults, sorted by file; none if the data set is sound.

    Raises:
        UserError: There is no data set in the folder.
    """
    spec = DatasetSpec.read(root)
    faults = set(_root_faults(spec, root))
    done = 0
    jobs = [job for job in spec.jobs() if job.folder(root).is_dir()]
    check = partial(scene_faults, spec, root)
    results = (check(job) for job in jobs) if workers == 1 else on_processes(check, jobs, workers)
    for job, found in results:
        faults.update(found)
        done += job.last - job.first
        if progress is not None:
            progress(done, spec.size)
    if not any(fault.file.split("/")[0] in SPLITS for fault in faults):
        faults.update(_derived_faults(spec, root))
    return sorted(faults)


def scene_faults(spec: DatasetSpec, root: Path, job: SceneJob) -> tuple[SceneJob, list[Fault]]:
    """Check one scene.

    Args:
        spec: What the data set was generated from.
        root: Folder of the data set.
        job: The scene.

    Returns:
        The scene and its faults.
    """
    name = f"{job.split}/{job.scene:06d}"
    checked = [Fault(f"{name}/{file}", problem) for file, problem in check_sums(job.folder(root), None)]
    faults = [*checked]
    broken = {fault.file for fault in checked}
    # A fault that the checksums show is reported once.
    for file, problem in check_scene(spec, root, job):
        if f"{name}/{file}" not in broken:
            faults.append(Fault(f"{name}/{file}", problem))
    return job, faults


def check_sums(folder: Path, expected: set[str] | None) -> Iterator[tuple[str, str]]:
    """Check the files of a folder against its SHA256SUMS.

    Args:
        folder: The folder.
        expected: Files that must be listed; None: all that are there.

    Yields:
        File, relative to the folder, and problem.
    """
    try:
        sums = read_sums(folder)
    except AssetError:
        yield SUMS, "missing" if not (folder / SUMS).exists() else "not a list of checksums"
        return
    if expected is None:
        there = (p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
        expected = {name for name in there if name != SUMS}
    for name in sorted(expected - set(sums)):
        yield name, f"not listed in {SUMS}: it is not part of the data set"
    for name, digest in sums.items():
        path = folder / name
        if not path.is_file():
            yield name, "missing"
        elif path.stat().st_size == 0:
            yield name, "empty"
        elif sha256(path) != digest:
            yield name, f"changed or corrupted: its SHA-256 is not the one in {SUMS}"


def _root_faults(spec: DatasetSpec, root: Path) -> Iterator[Fault]:
    if not is_finished(root):
        yield Fault(SUMS, "missing: the generation has not finished, run the same command again")
    else:
        for file, problem in check_sums(root, set(listed(root))):
            yield Fault(file, problem)
    wanted = {f"{job.split}/{job.scene:06d}" for job in spec.jobs()}
    there = {f"{split}/{p.name}" for split in SPLITS for p in (root / split).glob("*")}
    for scene in sorted(wanted - there):
        yield Fault(scene, "missing: the whole scene is not there")
    for scene in sorted(there - wanted):
        yield Fault(scene, "does not belong to this data set")


def _derived_faults(spec: DatasetSpec, root: Path) -> Iterator[Fault]:
    """Regenerate the files that follow from the scenes, and compare them."""
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        (out / MODELS).mkdir()
        try:
            summary = Summary(spec, root)
            for job in spec.jobs():
                summary.add(job)
            summary.write(out)
        except (TooleeError, KeyError, ValueError, TypeError) as error:
            yield Fault(COCO, f"cannot be derived from the scenes: {error}")
            return
        for path in sorted(p for p in out.rglob("*") if p.is_file()):
            file = path.relative_to(out).as_posix()
            if (root / file).is_file() and not _agree(root / file, path):
                yield Fault(file, "contradicts the scenes: it is not what follows from them")


def _agree(path: Path, derived: Path) -> bool:
    """Whether a file is the derived one; of the data card's words, all but the command, which older versions cut."""
    if path.name != README:
        return sha256(path) == sha256(derived)
    return _without_command(path.read_bytes()) == _without_command(derived.read_bytes())


def _without_command(card: bytes) -> list[bytes]:
    lines = card.splitlines()
    told = [line.startswith(GENERATED_BY.encode()) for line in lines]
    return [line for k, line in enumerate(lines) if not told[k] or k != told.index(True)]
