"""Do a scene's images, masks, poses, boxes, COCO entries and clouds agree with one another and with the tools?"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.errors import AssetError, TooleeError, UserError
from toolee_robot.frames import Array, is_rigid
from toolee_robot.perception.offline.dataset.clouds import MAX_POINTS, back_projected, read_clouds
from toolee_robot.perception.offline.dataset.encoding import rle
from toolee_robot.perception.offline.dataset.instances import object_of, read_ply, tool_path
from toolee_robot.perception.offline.dataset.paper_camera import CIRCLE
from toolee_robot.perception.offline.dataset.records import HEIGHT, SCENES, WIDTH
from toolee_robot.perception.offline.dataset.scene_reader import pose_of, read_image, read_json
from toolee_robot.perception.offline.dataset.scene_writer import COCO_CATEGORIES, bbox
from toolee_robot.perception.offline.dataset.spec import DatasetSpec, SceneJob
from toolee_robot.perception.offline.dataset.validation.pose_check import ENOUGH, SURFACE, is_thin, pose_fault
from toolee_robot.types import CameraIntrinsics

Problem = tuple[str, str]
"""A file of the scene, and what is wrong with it."""
Mask = NDArray[np.bool_]
_JSON = ("camera", "gt", "gt_info", "gt_coco", "instances")


def check_scene(spec: DatasetSpec, root: Path, job: SceneJob) -> Iterator[Problem]:
    """Look for contradictions in one scene.

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
        except (KeyError, TypeError, ValueError, IndexError) as error:
            yield "scene_gt.json", f"image {im_id}: an entry is missing or malformed ({error!r})"
    yield from checker.clouds()


class _Checker:
    """One scene."""

    def __init__(self, spec: DatasetSpec, root: Path, folder: Path, split: str, data: dict[str, Any]) -> None:
        self._root, self._folder, self._split = root, folder, split
        self._catalogue = spec.catalogue(root)
        self._data = data
        self._surfaces: dict[str, cKDTree | None] = {}
        self._clouds: dict[tuple[int, int], tuple[int, Array]] | None = None
        self._points: dict[tuple[int, int], Array] = {}

    def image(self, im_id: int) -> Iterator[Problem]:
        """Everything about one image."""
        name = f"{im_id:06d}"
        camera = self._data["camera"][str(im_id)]
        K = camera["cam_K"]
        if len(K) != 9 or not (K[0] > 0 and K[4] > 0) or camera["depth_scale"] != 1.0 or camera["scene"] not in SCENES:
            yield "scene_camera.json", f"image {im_id}: cam_K, depth_scale or scene is impossible"
            return
        intrinsics = CameraIntrinsics(K[0], K[4], K[2], K[5], WIDTH, HEIGHT)
        images: dict[str, NDArray[Any]] = {}
        for kind, suffix, dtype, ndim in (
            ("rgb", "jpg", "uint8", 3),
            ("depth", "png", "uint16", 2),
            ("tool", "png", "uint8", 2),
        ):
            file = f"{kind}/{name}.{suffix}"
            try:
                images[kind] = read_image(self._folder / file)
                if images[kind].dtype != dtype or images[kind].ndim != ndim:
                    yield file, f"holds {images[kind].dtype} of shape {images[kind].shape}"
                    del images[kind]
            except AssetError as error:
                yield file, str(error)
        gt, info = self._data["gt"][str(im_id)], self._data["gt_info"][str(im_id)]
        if len(gt) != len(info):
            yield "scene_gt_info.json", f"image {im_id}: {len(info)} entries for {len(gt)} in scene_gt.json"
            return
        masks: list[Mask] = []
        for k, (entry, about) in enumerate(zip(gt, info, strict=True)):
            where = f"image {im_id}, entry {k}"
            yield from self._labels(entry, where)
            pair: list[Mask] = []
            for kind in ("mask", "mask_visib"):
                file = f"{kind}/{name}_{k:06d}.png"
                try:
                    pair.append(read_image(self._folder / file) > 0)
                except AssetError as error:
                    yield file, str(error)
            if len(pair) < 2:
                masks.append(np.zeros((HEIGHT, WIDTH), np.bool_))
                continue
            full, visible = pair
            masks.append(visible)
            yield from self._mask(full, visible, about, images, f"{name}_{k:06d}.png", entry)
            if "depth" in images:
                yield from self._pose(visible, images["depth"], intrinsics, entry, where, camera["scene"])
                self._points[im_id, k] = back_projected(visible, images["depth"], intrinsics).astype(np.float64)
        stacked = np.sum(masks, axis=0) if masks else np.zeros((HEIGHT, WIDTH))
        if stacked.max() > 1:
            yield f"mask_visib/{name}_000000.png", "overlaps another EE's mask of the image"
        yield from self._coco(im_id, masks, gt, images.get("tool"))

    def _labels(self, entry: dict[str, Any], where: str) -> Iterator[Problem]:
        """Object, category, instance and split."""
        file = "scene_gt.json"
        try:
            number, ee = object_of(entry["obj_id"])
            end = self._catalogue.tool(number).ees[ee]
            name, split = self._catalogue.name(number), self._catalogue.split(number)
        except (UserError, AssetError, IndexError) as error:
            yield file, f"{where}: obj_id {entry['obj_id']} is no end effector ({error})"
            return
        if entry["category_id"] != end.category.spec.class_id:
            yield file, f"{where}: category_id {entry['category_id']}, but object {entry['obj_id']} is a {end.category}"
        if entry["instance"] != name:
            yield file, f"{where}: instance {entry['instance']}, but {entry['obj_id']} is of {name}"
        if split != self._split:
            yield file, f"{where}: {entry['instance']} belongs to the {split} split"
        X_ee, X_tool = pose_of(entry).astype(np.float64), pose_of(entry, "t2c").astype(np.float64)
        if not (is_rigid(X_ee, 1e-4) and is_rigid(X_tool, 1e-4)):
            yield file, f"{where}: a rotation matrix is not a rotation"
        elif not np.allclose(X_tool @ end.X_tool_ee, X_ee, atol=1e-4):
            yield file, f"{where}: the EE's pose does not fit its tool's"
        listed = self._data["instances"].get(entry["instance"], {}).get("objects", {})
        if str(entry["obj_id"]) not in listed:
            yield "scene_instances.json", f"{where}: lacks object {entry['obj_id']} of {entry['instance']}"

    def _mask(
        self,
        full: Mask,
        visible: Mask,
        about: dict[str, Any],
        images: dict[str, NDArray[Any]],
        name: str,
        entry: dict[str, Any],
    ) -> Iterator[Problem]:
        """A mask against what scene_gt_info says of it, and against the tool's."""
        seen, all_ = int(np.count_nonzero(visible)), int(np.count_nonzero(full))
        if (about["px_count_visib"], about["bbox_visib"]) != (seen, bbox(visible)):
            yield (
                f"mask_visib/{name}",
                f"{seen} pixels in {bbox(visible)}; scene_gt_info: {about['px_count_visib']} in {about['bbox_visib']}",
            )
        if (about["px_count_all"], about["bbox_obj"]) != (all_, bbox(full)):
            yield (
                f"mask/{name}",
                f"{all_} pixels in {bbox(full)}; scene_gt_info: {about['px_count_all']} in {about['bbox_obj']}",
            )
        if np.any(visible & ~full):
            yield f"mask_visib/{name}", "shows more than mask/ holds"
        if "tool" in images and np.any(images["tool"][visible] != entry["tool_id"]):
            yield f"mask_visib/{name}", f"is not on tool {entry['tool_id']}"
        if "depth" in images and about["px_count_valid"] != np.count_nonzero(images["depth"][visible]):
            yield "scene_gt_info.json", f"{name}: px_count_valid is not the number of pixels with a depth"

    def _pose(
        self,
        visible: Mask,
        depth: NDArray[np.uint16],
        K: CameraIntrinsics,
        entry: dict[str, Any],
        where: str,
        scene: str,
    ) -> Iterator[Problem]:
        """The points that the camera sees of the EE lie on its tool as the pose places it."""
        points = back_projected(visible, depth, K).astype(np.float64)
        surface = self._surface(entry["instance"])
        if len(points) < ENOUGH or surface is None:
            return
        X = pose_of(entry, "t2c").astype(np.float64)
        if not is_rigid(X, 1e-4):
            return
        origin = pose_of(entry)[:3, 3].astype(np.float64)
        if scene == "paper":
            aside = points[:, :2] / points[:, 2:] - origin[:2] / origin[2]
            within = np.linalg.norm(aside, axis=1) * K.fx < CIRCLE + 1.0
        else:
            radius = CATEGORIES[entry["category_id"] - 1].spec.radius
            within = np.linalg.norm(points - origin, axis=1) < radius + SURFACE
        fault = pose_fault(points, within, X, surface, K, is_thin(visible))
        if fault is not None:
            yield "scene_gt.json", f"{where}: the pose is off the mask: {fault}"

    def _surface(self, name: str) -> cKDTree | None:
        if name not in self._surfaces:
            try:
                vertices, faces = read_ply(tool_path(self._root, name))
                mesh = trimesh.Trimesh(1e-3 * vertices, faces, process=False)
                self._surfaces[name] = cKDTree(trimesh.sample.sample_surface(mesh, 6000, seed=0)[0])
            except TooleeError:
                self._surfaces[name] = None  # the checksums tell it
        return self._surfaces[name]

    def _coco(
        self, im_id: int, masks: list[Mask], gt: list[dict[str, Any]], tool: NDArray[np.uint8] | None
    ) -> Iterator[Problem]:
        """The COCO entries of an image are those masks, and no others."""
        file, where = "scene_gt_coco.json", f"image {im_id}"
        left = {k for k, mask in enumerate(masks) if mask.any()}
        tools = set(np.unique(tool[tool > 0]).tolist()) if tool is not None else None
        for annotation in self._data["gt_coco"]["annotations"]:
            if annotation["image_id"] != im_id:
                continue
            try:
                mask = rle.decode(annotation["segmentation"])
            except UserError as error:
                yield file, f"{where}: {error}"
                continue
            if "gt_id" in annotation:
                k = annotation["gt_id"]
                left.discard(k)
                if k >= len(gt) or annotation["category_id"] != gt[k]["category_id"]:
                    yield (
                        file,
                        f"{where}: annotation {annotation['id']} has another category than scene_gt.json",
                    )
                    continue
                expected: Mask | None = masks[k]
            else:
                if annotation["category_id"] != len(COCO_CATEGORIES):
                    yield file, f"{where}: annotation {annotation['id']} is neither an EE's nor a tool's"
                if tools is not None:
                    tools.discard(annotation["tool_id"])
                expected = None if tool is None else tool == annotation["tool_id"]
            right_box = annotation["bbox"] == bbox(mask) and annotation["area"] == int(np.count_nonzero(mask))
            if (expected is not None and not np.array_equal(mask, expected)) or not right_box:
                yield file, f"{where}: annotation {annotation['id']} is not the image's mask"
        if left or tools:
            yield file, f"{where}: lacks an annotation"

    def clouds(self) -> Iterator[Problem]:
        """The clouds are the masks' pixels, back-projected."""
        try:
            clouds = read_clouds(self._folder)
        except AssetError as error:
            yield "clouds.npz", str(error)
            return
        where = list(zip(clouds.image.tolist(), clouds.gt.tolist(), strict=True))
        seen = {key for key, points in self._points.items() if len(points)}
        if missing := seen - set(where):
            yield "clouds.npz", f"lacks the cloud of image {min(missing)[0]}, entry {min(missing)[1]}"
        for m, key in enumerate(where):
            full, points = self._points.get(key), clouds[m]
            if full is None:
                if self._data["gt"].get(str(key[0])) is None or key[1] >= len(self._data["gt"][str(key[0])]):
                    yield "clouds.npz", f"cloud {m} is of image {key[0]}, entry {key[1]}, which is not there"
                continue
            right = clouds.count[m] == len(full) and len(points) == min(len(full), MAX_POINTS)
            if right and len(full):
                right = float(cKDTree(full).query(points)[0].max()) < 1e-5
            if not right:
                yield "clouds.npz", f"the cloud of image {key[0]}, entry {key[1]} is not what its mask and depth give"
