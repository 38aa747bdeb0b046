"""Point clouds of the EEs of a scene, stored in `clouds.npz` with the arrays of `Clouds`."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import AssetError, words_of
from toolee_robot.perception.offline.dataset.records import Example, FloatArray, pixels_of
from toolee_robot.types import CameraIntrinsics

MAX_POINTS = 1024
"""Maximum number of points of a cloud; larger clouds are sampled randomly."""


def back_projected(mask: NDArray[np.bool_], depth_mm: NDArray[np.uint16], K: CameraIntrinsics) -> FloatArray:
    """Back-project the pixels of a mask that have a depth.

    Args:
        mask: Pixels to project (H, W).
        depth_mm: Depth (H, W) [mm]; 0 where unknown.
        K: Intrinsics of the camera.

    Returns:
        Points (N, 3) [m], camera frame, in row-major order of the pixels.
    """
    rows, columns = pixels_of(mask & (depth_mm > 0))
    z = depth_mm[rows, columns] * 1e-3
    return (z[:, None] * K.rays(np.stack([columns, rows], axis=-1))).astype(np.float32)


class CloudWriter:
    """Collector of the clouds of a scene."""

    def __init__(self) -> None:
        self._where: list[tuple[int, int, int]] = []
        self._points: list[FloatArray] = []

    def add(self, image: int, gt: int, mask: NDArray[np.bool_], e: Example) -> None:
        """Add the cloud of one EE.

        Args:
            image: Index of the image in the scene.
            gt: Index of the EE in the entry of the image in scene_gt.
            mask: Visible mask of the EE (H, W).
            e: The example.
        """
        points = back_projected(mask, e.depth_mm, e.intrinsics)
        count = len(points)
        if count > MAX_POINTS:
            points = points[np.sort(np.random.default_rng([image, gt, count]).permutation(count)[:MAX_POINTS])]
        self._where.append((image, gt, count))
        self._points.append(points)

    def to_bytes(self) -> bytes:
        """Content of `clouds.npz`."""
        where = np.array(self._where, np.int32).reshape(-1, 3)
        points = np.concatenate([np.zeros((0, 3), np.float32), *self._points])
        ends = np.cumsum([len(p) for p in self._points], dtype=np.int64)
        buffer = BytesIO()
        np.savez(buffer, image=where[:, 0], gt=where[:, 1], count=where[:, 2], ends=ends, points=points)
        return buffer.getvalue()


@dataclass(frozen=True, eq=False)
class Clouds:
    """The M clouds of one scene.

    Attributes:
        image: Index of the image of each cloud (M,).
        gt: Index of the EE in scene_gt of each cloud (M,).
        count: Pixels with a depth in the mask of each cloud (M,), before sampling.
        ends: End of each cloud in `points` (M,): cloud m is points[ends[m - 1] : ends[m]].
        points: Points of all clouds (sum, 3) [m], camera frame; at most `MAX_POINTS` of each cloud.
    """

    image: NDArray[np.int32]
    gt: NDArray[np.int32]
    count: NDArray[np.int32]
    ends: NDArray[np.int64]
    points: FloatArray

    def __len__(self) -> int:
        return len(self.image)

    def __getitem__(self, m: int) -> FloatArray:
        """Points (n, 3) [m] of cloud m, n <= `MAX_POINTS`."""
        return self.points[int(self.ends[m - 1]) if m else 0 : int(self.ends[m])]


def read_clouds(scene: Path) -> Clouds:
    """Read the clouds of a scene.

    Args:
        scene: Folder of the scene.

    Raises:
        AssetError: The file is missing or corrupt; the message names it.
    """
    path = scene / "clouds.npz"
    try:
        with np.load(path, allow_pickle=False) as file:
            clouds = Clouds(file["image"], file["gt"], file["count"], file["ends"], file["points"])
    except Exception as error:
        raise AssetError(
            f"cannot read {path}: {words_of(error)}; delete its scene and generate the data set again"
        ) from error
    lengths = {len(clouds.image), len(clouds.gt), len(clouds.count), len(clouds.ends)}
    if (
        len(lengths) != 1
        or (len(clouds) and int(clouds.ends[-1]) != len(clouds.points))
        or np.any(np.diff(clouds.ends) < 0)
    ):
        raise AssetError(f"{path} holds arrays that do not fit together: delete its scene and generate it again")
    return clouds
