"""Reading of BOP scenes, for training and inspection; `scene_writer` describes the layout."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from toolee_robot.errors import AssetError, words_of
from toolee_robot.perception.offline.dataset.records import (
    HEIGHT,
    POSES,
    SCENES,
    SUMS,
    WIDTH,
    EeTable,
    FloatArray,
    read_json,
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
        raise AssetError(
            f"{path} is {pixels.shape[1]}x{pixels.shape[0]}, not {WIDTH}x{HEIGHT}", code="asset.image_size"
        )
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
