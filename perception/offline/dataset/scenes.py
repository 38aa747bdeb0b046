"""Scenes in the BOP layout: reading, for training and inspection, and writing. Equal examples give identical bytes.

    train/000000/rgb/000000.jpg            quality 95, full chroma
    train/000000/depth/000000.png          uint16 [mm], 0 where unknown
    train/000000/tool/000000.png           id of the tool at each pixel, 0 for none
    train/000000/mask/000000_000000.png    unoccluded mask of an EE (image, index in scene_gt)
    train/000000/mask_visib/...            visible mask of the EE
    train/000000/scene_{camera,gt,gt_info,gt_coco,instances}.json
    train/000000/clouds.npz                see `CloudWriter.to_bytes`
    train/000000/SHA256SUMS

Training reads these files directly. BOP fields have the meaning and units (mm) of BOP; additional
fields have names of their own.

The PNG files have one filter for all rows and are compressed by ISA-L. That takes a sixth of the time of libraries that
try five filters on each row. The files are no larger, because all rows of a depth image are alike and a mask is small
anyway.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import struct
import zlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from faster_coco_eval.core import mask as coco_mask
from isal import isal_zlib
from numpy.typing import NDArray
from PIL import Image

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.errors import AssetError, words_of
from toolee_robot.perception.offline.dataset.catalogue import GENERATED, Catalogue
from toolee_robot.perception.offline.dataset.instances import object_of
from toolee_robot.perception.offline.dataset.records import (
    HEIGHT,
    MIN_POINTS,
    POSES,
    SCENES,
    SUMS,
    WIDTH,
    CloudWriter,
    EeTable,
    Example,
    FloatArray,
    json_by_line,
    read_json,
    write_sums,
)
from toolee_robot.types import CameraIntrinsics, RgbdFrame

_TABLE = tuple(field.name for field in fields(EeTable))


@dataclass(frozen=True, eq=False)
class SegmentationSet:
    """A loaded data set of N images.

    Attributes:
        rgb: Colour images (N, H, W, 3), sRGB.
        depth_mm: Depth images (N, H, W) [mm]; 0 where unknown.
        ee: Id of the EE at each pixel (N, H, W), 0 for none.
        tool: Id of the tool at each pixel (N, H, W), 0 for none.
        table: Labels of the EEs, leading shape (N, 8).
        intrinsics: fx, fy, cx, cy of each image (N, 4) [px].
        scene: Kind of scene of each image (N,), indices into `records.SCENES`.
    """

    rgb: NDArray[np.uint8]
    depth_mm: NDArray[np.uint16]
    ee: NDArray[np.uint8]
    tool: NDArray[np.uint8]
    table: EeTable
    intrinsics: NDArray[np.float64]
    scene: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.rgb)

    @property
    def categories(self) -> NDArray[np.uint8]:
        """Class index (N, 8) of EE ids 1..8: 1..4 in the order of `Category`, 0 where there is no EE."""
        return self.table.category

    def camera(self, i: int) -> CameraIntrinsics:
        """Intrinsics of image i."""
        height, width = self.rgb.shape[1:3]
        fx, fy, cx, cy = (float(v) for v in self.intrinsics[i])
        return CameraIntrinsics(fx, fy, cx, cy, width, height)

    def frame(self, i: int) -> RgbdFrame:
        """Image i as a camera frame, depth in metres."""
        return RgbdFrame(self.rgb[i], self.depth_mm[i].astype(np.float32) * np.float32(1e-3), self.camera(i))

    def row(self, i: int) -> EeTable:
        """Labels of image i, leading shape (8,)."""
        return EeTable(**{name: getattr(self.table, name)[i] for name in _TABLE})


def scene_folders(split: Path) -> list[Path]:
    """Folders of the complete scenes of a split, sorted by number."""
    return sorted(p for p in split.glob("[0-9]*") if (p / SUMS).is_file())


def load(folder: Path, limit: int | None = None, threads: int = 8) -> SegmentationSet:
    """Read a split.

    Args:
        folder: Folder of the split.
        limit: Maximum number of images; None: all.
        threads: Number of decoding threads.

    Returns:
        The images with their labels, in the order of scenes and images.

    Raises:
        AssetError: There is no complete scene, or a file is missing or corrupt; the message names it.
    """
    scenes = scene_folders(folder)
    if not scenes:
        raise AssetError(
            f"no BOP scene in {folder}: give the folder train or test of a data set made by `toolee dataset generate`",
            code="asset.no_scene",
        )
    return load_scenes(scenes, limit, threads)


def load_scenes(scenes: Sequence[Path], limit: int | None = None, threads: int = 8) -> SegmentationSet:
    """Read scenes.

    Args:
        scenes: Folders of the scenes.
        limit: Maximum number of images; None: all.
        threads: Number of decoding threads.

    Returns:
        The images with their labels, in the order of scenes and images.

    Raises:
        AssetError: A file is missing or corrupt; the message names it.
    """
    jobs: list[tuple[Path, int]] = []
    described: list[_Description] = []
    for scene in scenes:
        if limit is not None and len(jobs) >= limit:
            break
        description = _Description.read(scene)
        described.append(description)
        jobs += [(scene, i) for i in range(len(description.scene))]
    total = len(jobs) if limit is None else min(len(jobs), limit)
    table = EeTable(**{n: np.concatenate([getattr(d.table, n) for d in described])[:total] for n in _TABLE})
    rgb = np.empty((total, HEIGHT, WIDTH, 3), np.uint8)
    ee, tool = np.zeros((total, HEIGHT, WIDTH), np.uint8), np.empty((total, HEIGHT, WIDTH), np.uint8)
    depth_mm = np.empty((total, HEIGHT, WIDTH), np.uint16)

    def decode(i: int) -> None:
        scene, im_id = jobs[i]
        rgb[i] = read_image(scene / f"rgb/{im_id:06d}.jpg")
        tool[i] = read_image(scene / f"tool/{im_id:06d}.png")
        for row in np.flatnonzero(table.visible[i]):
            mask = read_image(scene / f"mask_visib/{im_id:06d}_{row:06d}.png")
            np.copyto(ee[i], np.uint8(row + 1), where=mask.astype(np.bool_, copy=False))
        depth_mm[i] = read_image(scene / f"depth/{im_id:06d}.png")

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(decode, range(total)))
    intrinsics = np.concatenate([d.intrinsics for d in described])[:total]
    return SegmentationSet(
        rgb, depth_mm, ee, tool, table, intrinsics, np.concatenate([d.scene for d in described])[:total]
    )


def read_image(path: Path) -> NDArray[Any]:
    """Pixels of an image file of a scene, (H, W) or (H, W, 3).

    Raises:
        AssetError: The file is missing, corrupt or of another size; the message names it.
    """
    try:
        with Image.open(path) as image:
            pixels = np.asarray(image)
    except (OSError, ValueError, SyntaxError) as error:
        raise AssetError(
            f"cannot read {path}: {words_of(error)}; delete its scene and generate the data set again"
        ) from error
    if pixels.shape[:2] != (HEIGHT, WIDTH):
        raise AssetError(f"{path} is {pixels.shape[1]}x{pixels.shape[0]}, not {WIDTH}x{HEIGHT}")
    return pixels


@dataclass(frozen=True)
class _Description:
    """The JSON files of a scene of N images as arrays.

    Attributes:
        table: Labels of the EEs, leading shape (N, 8).
        intrinsics: fx, fy, cx, cy of each image (N, 4) [px].
        scene: Kind of scene of each image (N,), indices into `records.SCENES`.
    """

    table: EeTable
    intrinsics: NDArray[np.float64]
    scene: NDArray[np.uint8]

    @staticmethod
    def read(folder: Path) -> _Description:
        camera, gt, info = (read_json(folder / f"scene_{name}.json") for name in ("camera", "gt", "gt_info"))
        try:
            rows = [table_of(gt[str(i)], info[str(i)]) for i in range(len(camera))]
            K = np.array([[camera[str(i)]["cam_K"][k] for k in (0, 4, 2, 5)] for i in range(len(camera))], np.float64)
            kinds = np.array([SCENES.index(camera[str(i)]["scene"]) for i in range(len(camera))], np.uint8)
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise AssetError(
                f"{folder}/scene_*.json do not fit together: {error!r}; generate the scene again"
            ) from error
        table = EeTable(**{name: np.stack([getattr(row, name) for row in rows]) for name in _TABLE})
        return _Description(table, K, kinds)


def table_of(gt: list[dict[str, Any]], info: list[dict[str, Any]]) -> EeTable:
    """Labels of the EEs of one image.

    Args:
        gt: Entries of the image in scene_gt.
        info: Entries of the image in scene_gt_info, in the same order.

    Returns:
        The labels, leading shape (8,).

    Raises:
        KeyError: A field is missing.
        ValueError: The lists differ in length or a pose has another shape.
    """
    table = EeTable.empty()
    for row, (entry, seen) in enumerate(zip(gt, info, strict=True)):
        table.category[row], table.tool[row] = entry["category_id"], entry["tool_id"]
        table.obj_id[row] = entry["obj_id"]
        for suffix, name in POSES.items():
            if f"cam_R_{suffix}" in entry:
                getattr(table, name)[row] = pose_of(entry, suffix)
        table.mirrored[row] = entry["left_hand"]
        table.visible[row], table.unoccluded[row] = seen["px_count_visib"], seen["px_count_all"]
    return table


def pose_of(entry: dict[str, Any], suffix: str = "m2c") -> FloatArray:
    """Pose of an entry of scene_gt.

    Args:
        entry: The entry; its translations are in millimetres.
        suffix: Key of `records.POSES`.

    Returns:
        X_camera_* (4x4) [m].

    Raises:
        KeyError: The entry has no such pose.
        ValueError: The pose has another shape.
    """
    X = np.eye(4)
    X[:3, :3] = np.reshape(entry[f"cam_R_{suffix}"], (3, 3))
    X[:3, 3] = np.reshape(entry[f"cam_t_{suffix}"], 3) * 1e-3
    return X.astype(np.float32)


_GREY, _NO_FILTER, _LEFT = 0, 0, 1
_LEVEL = 1


def png_bytes(pixels: NDArray[Any]) -> bytes:
    """The file of an image (H, W) of uint16, uint8 or bool (one bit a pixel)."""
    height, width = pixels.shape
    if pixels.dtype == np.bool_:
        bits, rows = 1, np.packbits(pixels, axis=1)
    elif pixels.dtype == np.uint8:
        bits, rows = 8, pixels
    elif pixels.dtype == np.uint16:
        bits, rows = 16, np.ascontiguousarray(pixels, ">u2").view(np.uint8)
    else:
        raise TypeError(f"no PNG of {pixels.dtype}")
    data = np.empty((height, 1 + rows.shape[1]), np.uint8)
    if bits == 16:
        # Byte by byte what changed from the left neighbour's.
        data[:, 0], data[:, 1:3] = _LEFT, rows[:, :2]
        np.subtract(rows[:, 2:], rows[:, :-2], out=data[:, 3:])
    else:
        data[:, 0], data[:, 1:] = _NO_FILTER, rows
    header = struct.pack(">IIBBBBB", width, height, bits, _GREY, 0, 0, 0)
    return b"".join(
        [
            b"\x89PNG\r\n\x1a\n",
            _chunk(b"IHDR", header),
            _chunk(b"IDAT", isal_zlib.compress(data, _LEVEL)),
            _chunk(b"IEND", b""),
        ]
    )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))


COCO_CATEGORIES = [
    {"id": k + 1, "name": str(name), "supercategory": "end_effector"} for k, name in enumerate(CATEGORIES)
]
COCO_CATEGORIES.append({"id": len(CATEGORIES) + 1, "name": "tool", "supercategory": "tool"})


def write_scene(
    folder: Path,
    examples: Iterable[Example],
    write_models: Callable[[Iterable[int]], None] | None = None,
    catalogue: Catalogue = GENERATED,
) -> None:
    """Write examples as one BOP scene, atomically: the folder appears only when it is complete.

    Args:
        folder: Folder of the scene; its name is the number of the scene.
        examples: The examples, in order.
        write_models: Called with the obj_ids of the scene before the folder appears.
        catalogue: Tools of the examples.
    """
    scratch = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    shutil.rmtree(scratch, ignore_errors=True)
    for name in ("rgb", "depth", "tool", "mask", "mask_visib"):
        (scratch / name).mkdir(parents=True)
    sums: dict[str, str] = {}

    def write(name: str, data: bytes) -> None:
        (scratch / name).write_bytes(data)
        sums[name] = hashlib.sha256(data).hexdigest()

    writer = SceneWriter(write, catalogue)
    for example in examples:
        writer.add(example)
    writer.close()
    write_sums(scratch, sums)
    if write_models is not None:
        write_models(writer.objects)
    try:
        scratch.rename(folder)
    except OSError:
        if not folder.exists():
            raise
        shutil.rmtree(scratch)  # another process wrote the same scene meanwhile


class SceneWriter:
    """Encodes the files of a scene, one example after the other; only their labels stay in memory.

    Args:
        write: Takes the name of a file in the scene, and its content.
        catalogue: Tools of the examples.
    """

    def __init__(self, write: Callable[[str, bytes], None], catalogue: Catalogue) -> None:
        self._file, self._catalogue = write, catalogue
        self._camera: dict[str, Any] = {}
        self._gt: dict[str, Any] = {}
        self._info: dict[str, Any] = {}
        self._annotations: list[dict[str, Any]] = []
        self._instances: dict[str, dict[str, Any]] = {}
        self._clouds = CloudWriter()

    def add(self, e: Example) -> None:
        """Write the next example."""
        im_id = len(self._camera)
        key, name = str(im_id), f"{im_id:06d}"
        self._file(f"rgb/{name}.jpg", _jpeg(e.rgb))
        self._file(f"depth/{name}.png", png_bytes(e.depth_mm))
        self._file(f"tool/{name}.png", png_bytes(e.tool))
        K = e.intrinsics
        cam_K = [K.fx, 0.0, K.cx, 0.0, K.fy, K.cy, 0.0, 0.0, 1.0]
        self._camera[key] = {"cam_K": cam_K, "depth_scale": 1.0, "scene": SCENES[e.scene]}
        self._gt[key], self._info[key] = [], []
        targets, measured = e.table.targets, e.depth_mm > 0
        for gt, row in enumerate(np.flatnonzero(e.table.category)):
            visible, full = e.ee == row + 1, e.full & np.uint8(1 << row) != 0
            self._file(f"mask/{name}_{gt:06d}.png", png_bytes(full))
            self._file(f"mask_visib/{name}_{gt:06d}.png", png_bytes(visible))
            number, _ = object_of(int(e.table.obj_id[row]))
            entry = _gt_entry(e.table, int(row), self._catalogue.name(number))
            self._gt[key].append(entry)
            info = _info_entry(visible, full, measured, bool(targets[row]))
            self._info[key].append(info)
            instance = {**self._catalogue.listed(number).about, "objects": {}}
            instance = self._instances.setdefault(entry["instance"], instance)
            instance["objects"][str(entry["obj_id"])] = str(CATEGORIES[entry["category_id"] - 1])
            if info["px_count_visib"]:
                more = {"obj_id": entry["obj_id"], "gt_id": gt}
                self._annotate(visible, info["bbox_visib"], im_id, entry["category_id"], more)
                self._clouds.add(im_id, gt, visible, e)
        for tool_id in range(1, int(e.tool.max()) + 1):
            mask = e.tool == tool_id
            if mask.any():
                self._annotate(mask, bbox(mask), im_id, len(COCO_CATEGORIES), {"tool_id": tool_id})

    @property
    def objects(self) -> set[int]:
        """The obj_ids of the examples written so far."""
        return {entry["obj_id"] for entries in self._gt.values() for entry in entries}

    def close(self) -> None:
        """Write the files that describe the whole scene."""
        images = [
            {"id": i, "file_name": f"rgb/{i:06d}.jpg", "width": WIDTH, "height": HEIGHT}
            for i in range(len(self._camera))
        ]
        coco = {"images": images, "categories": COCO_CATEGORIES, "annotations": self._annotations}
        self._file("scene_camera.json", json_by_line(self._camera))
        self._file("scene_gt.json", json_by_line(self._gt))
        self._file("scene_gt_info.json", json_by_line(self._info))
        self._file("scene_gt_coco.json", json.dumps(coco, separators=(",", ":")).encode() + b"\n")
        self._file("scene_instances.json", json_by_line(dict(sorted(self._instances.items()))))
        self._file("clouds.npz", self._clouds.to_bytes())

    def _annotate(
        self, mask: NDArray[np.bool_], box: list[int], im_id: int, category: int, more: dict[str, Any]
    ) -> None:
        """Add a COCO annotation; masks below `MIN_POINTS` are marked as crowd, which evaluation ignores."""
        area = int(np.count_nonzero(mask))
        entry = {"id": len(self._annotations), "image_id": im_id, "category_id": category, "bbox": box}
        crowd = int(area < MIN_POINTS)
        coded = coco_mask.encode(np.asfortranarray(mask.view(np.uint8)))
        runs = {"size": coded["size"], "counts": coded["counts"].decode()}
        self._annotations.append({**entry, "area": area, "iscrowd": crowd, "segmentation": runs, **more})


def _gt_entry(table: EeTable, row: int, instance: str) -> dict[str, Any]:
    entry: dict[str, Any] = {"obj_id": int(table.obj_id[row])}
    for suffix, name in POSES.items():
        X = np.asarray(getattr(table, name)[row], np.float64)
        if np.all(np.isfinite(X)):
            # Nine significant digits restore a float32 exactly.
            entry[f"cam_R_{suffix}"] = [float(f"{v:.9g}") for v in X[:3, :3].reshape(-1).tolist()]
            entry[f"cam_t_{suffix}"] = [float(f"{1e3 * v:.9g}") for v in X[:3, 3].tolist()]
    more = {"category_id": int(table.category[row]), "tool_id": int(table.tool[row])}
    return {**entry, **more, "instance": instance, "left_hand": bool(table.mirrored[row])}


def _info_entry(
    visible: NDArray[np.bool_], full: NDArray[np.bool_], measured: NDArray[np.bool_], target: bool
) -> dict[str, Any]:
    seen, all_ = int(np.count_nonzero(visible)), int(np.count_nonzero(full))
    return {
        "bbox_obj": bbox(full),
        "bbox_visib": bbox(visible),
        "px_count_all": all_,
        "px_count_valid": int(np.count_nonzero(visible & measured)),
        "px_count_visib": seen,
        "visib_fract": round(min(seen / all_, 1.0), 6) if all_ else 0.0,
        "target": target,
    }


def bbox(mask: NDArray[np.bool_]) -> list[int]:
    """Bounding box x, y, width, height [px] of a mask (H, W); all -1 for an empty mask, as in BOP."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return [-1, -1, -1, -1]
    return [int(columns[0]), int(rows[0]), int(columns[-1] - columns[0]) + 1, int(rows[-1] - rows[0]) + 1]


def _jpeg(rgb: NDArray[np.uint8]) -> bytes:
    buffer = BytesIO()
    Image.fromarray(rgb).save(buffer, "JPEG", quality=95, subsampling=0)
    return buffer.getvalue()
