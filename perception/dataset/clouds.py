"""The clouds of a scene: what the depth camera sees of each EE, in `clouds.npz`.

image, gt (M,) int32: which EE of which image (the place in scene_gt). ends (M,) int64: cloud m is
points[ends[m-1]:ends[m]]. points (sum, 3) float32 [m], camera frame, a random 1024 of the mask's pixels at most.
count (M,) int32: how many pixels had a depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import AssetError
from toolee_robot.perception.dataset.encoding.masks import pixels_of
from toolee_robot.perception.dataset.records import Example, FloatArray
from toolee_robot.types import CameraIntrinsics

MAX_POINTS = 1024


def back_projected(mask: NDArray[np.bool_], depth_mm: NDArray[np.uint16], K: CameraIntrinsics) -> FloatArray:
    """Points (N, 3) [m], camera frame, of the mask's pixels that have a depth."""
    rows, columns = pixels_of(mask & (depth_mm > 0))
    z = depth_mm[rows, columns] * 1e-3
    return np.column_stack([(columns - K.cx) / K.fx * z, (rows - K.cy) / K.fy * z, z]).astype(np.float32)


class CloudWriter:
    """Collects the clouds of a scene."""

    def __init__(self) -> None:
        self._where: list[tuple[int, int, int]] = []
        self._points: list[FloatArray] = []

    def add(self, image: int, gt: int, mask: NDArray[np.bool_], e: Example) -> None:
        """The cloud of one EE."""
        points = back_projected(mask, e.depth_mm, e.intrinsics)
        count = len(points)
        if count > MAX_POINTS:
            points = points[np.sort(np.random.default_rng([image, gt, count]).permutation(count)[:MAX_POINTS])]
        self._where.append((image, gt, count))
        self._points.append(points)

    def to_bytes(self) -> bytes:
        """The file."""
        where = np.array(self._where, np.int32).reshape(-1, 3)
        points = np.concatenate([np.zeros((0, 3), np.float32), *self._points])
        ends = np.cumsum([len(p) for p in self._points], dtype=np.int64)
        buffer = BytesIO()
        np.savez(buffer, image=where[:, 0], gt=where[:, 1], count=where[:, 2], ends=ends, points=points)
        return buffer.getvalue()


@dataclass(frozen=True, eq=False)
class Clouds:
    """The clouds of one scene; see the module."""

    image: NDArray[np.int32]
    gt: NDArray[np.int32]
    count: NDArray[np.int32]
    ends: NDArray[np.int64]
    points: FloatArray

    def __len__(self) -> int:
        return len(self.image)

    def __getitem__(self, m: int) -> FloatArray:
        """(n, 3) cloud m, n up to 1024."""
        return self.points[int(self.ends[m - 1]) if m else 0 : int(self.ends[m])]


def read_clouds(scene: Path) -> Clouds:
    """The clouds of a scene's folder. Raises AssetError naming the file."""
    path = scene / "clouds.npz"
    try:
        with np.load(path, allow_pickle=False) as file:
            clouds = Clouds(file["image"], file["gt"], file["count"], file["ends"], file["points"])
    except Exception as error:
        raise AssetError(f"cannot read {path}: {error!r}; delete its scene and generate the data set again") from error
    lengths = {len(clouds.image), len(clouds.gt), len(clouds.count), len(clouds.ends)}
    if (
        len(lengths) != 1
        or (len(clouds) and int(clouds.ends[-1]) != len(clouds.points))
        or np.any(np.diff(clouds.ends) < 0)
    ):
        raise AssetError(f"{path} holds arrays that do not fit together: delete its scene and generate it again")
    return clouds
