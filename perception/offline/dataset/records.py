"""Records of synthetic examples, the numbering of their end effectors (EE), and the files that hold them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import AssetError, words_of
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.runtime.files import from_json, read_text, write_atomic
from toolee_robot.types import CameraIntrinsics, RgbdFrame

SUMS = "SHA256SUMS"


def write_sums(folder: Path, sums: dict[str, str]) -> None:
    """Write the SHA256SUMS of a folder atomically, as `sha256sum -c` reads it.

    Args:
        folder: The folder.
        sums: Path in the folder -> SHA-256, hexadecimal.
    """
    text = "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items()))
    write_atomic(folder / SUMS, text.encode())


def json_by_line(entries: dict[str, Any]) -> bytes:
    """A JSON object with one entry per line, for readable files and diffs."""
    lines = [f"  {json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in entries.items()]
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode()


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        AssetError: The file is missing or not valid JSON; the message names it.
    """
    try:
        return from_json(read_text(path))
    except (OSError, ValueError) as error:
        raise AssetError(
            f"cannot read {path}: {words_of(error)}; delete its scene and generate the data set again"
        ) from error


HEIGHT, WIDTH = 424, 512
"""Size [px] of every image of the data set."""
MAX_EES = 8
"""Maximum number of EEs in an image; EE ids are 1..MAX_EES."""
MIN_POINTS = 50
"""Minimum visible pixels of a labelled EE; with fewer it is ignored: neither a target nor a false positive."""
NEAREST, FARTHEST = 0.4, 1.1
"""Range of depths [m] at which EEs are placed."""
SHOWN_HAND = SHADOW_HAND
"""Hand model that holds the tools, possibly mirrored; `X_camera_hand` is the pose of its hand frame."""
MAX_OCCLUSION = 0.7
"""Maximum occluded fraction of a target."""
INSTANCES = 150
"""Tools of each kind, with seeds from 0; each fifth is held out."""
SCENES = ("hard", "station", "empty", "paper")
"""Kinds of scenes; `Example.scene` is an index into it. hard: random tools, poses and clutter; station: a UR10 with a
hand shows a tool; empty: no tool; paper: the protocol of the paper."""
POSES = {"m2c": "X_camera_ee", "t2c": "X_camera_tool", "h2c": "X_camera_hand"}
"""Suffix of cam_R_ and cam_t_ in scene_gt -> field of `EeTable`: pose of the EE (the model in BOP), of the tool and
of the hand in the camera frame."""

TEXTURES, ROOMS, BACKDROPS = 1000, 1000, 1000
"""Numbers of textures, rooms and backdrops in both splits."""
FULL_WIDTH, FULL_HEIGHT = 960, 540
"""Size [px] of the full image of the paper's protocol; a window of it is rendered."""
FOCAL = 480.0
"""Focal length [px]: a field of view of about 90 degrees."""
CIRCLE = 30.0
"""Radius [px] of the EE mask about the EE origin: 2.6 to 6.1 cm at depths of 0.42 to 0.98 m."""

FloatArray = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class EeTable:
    """Labels of the EEs of one image (leading shape (8,)) or of N images (leading shape (N, 8)); EE id k is row k - 1.

    Attributes:
        category: Class index, uint8; 0 where there is no EE.
        tool: Id of the tool in the image (1..3), uint8.
        obj_id: BOP object id, int32: an EE of a tool (`instances.object_of`).
        X_camera_ee: Pose of the EE in the camera frame (..., 4, 4) [m], float32.
        X_camera_tool: Pose of the tool in the camera frame (..., 4, 4) [m], float32.
        X_camera_hand: Pose of the hand in the camera frame (..., 4, 4) [m], float32; NaN where no hand holds the tool.
        mirrored: Whether the hand is a left hand.
        visible: Pixels of the visible mask, int32.
        unoccluded: Pixels of the mask with the tool alone in the scene, int32.
    """

    category: NDArray[np.uint8]
    tool: NDArray[np.uint8]
    obj_id: NDArray[np.int32]
    X_camera_ee: FloatArray
    X_camera_tool: FloatArray
    X_camera_hand: FloatArray
    mirrored: NDArray[np.bool_]
    visible: NDArray[np.int32]
    unoccluded: NDArray[np.int32]

    @staticmethod
    def empty() -> EeTable:
        """A table of one image without EEs."""
        pose = np.full((MAX_EES, 4, 4), np.nan, np.float32)
        return EeTable(
            np.zeros(MAX_EES, np.uint8),
            np.zeros(MAX_EES, np.uint8),
            np.zeros(MAX_EES, np.int32),
            pose.copy(),
            pose.copy(),
            pose.copy(),
            np.zeros(MAX_EES, np.bool_),
            np.zeros(MAX_EES, np.int32),
            np.zeros(MAX_EES, np.int32),
        )

    @property
    def occlusion(self) -> FloatArray:
        """Occluded fraction of the in-image mask of each EE, in [0, 1]."""
        full = np.maximum(self.unoccluded, 1)
        return np.clip(1.0 - self.visible / full, 0.0, 1.0).astype(np.float32)

    @property
    def targets(self) -> NDArray[np.bool_]:
        """Whether each EE is a target of detection and pose estimation.

        A target has at least 50 visible pixels, is at most 70 % occluded and at a depth of 0.4 to 1.1 m.
        """
        depth = self.X_camera_ee[..., 2, 3]
        known = (self.category > 0) & (self.visible >= MIN_POINTS) & (self.occlusion <= MAX_OCCLUSION)
        with np.errstate(invalid="ignore"):
            return known & (depth >= NEAREST) & (depth <= FARTHEST)


@dataclass(frozen=True, eq=False)
class Example:
    """A synthetic image with labels.

    Attributes:
        rgb: Colour image (H, W, 3), sRGB.
        depth_mm: Depth with sensor noise (H, W) [mm]; 0 where unknown.
        ee: Id of the EE at each pixel (H, W), 0 for none. A pixel of a tool belongs to the EE whose sphere
            (`EndEffectorSpec.radius`) contains it; where spheres overlap, to the relatively nearer one.
        tool: Id of the tool at each pixel (H, W), 0 for none.
        table: Labels of the EEs.
        intrinsics: Intrinsics of the camera.
        scene: Kind of scene, an index into `SCENES`.
        full: Unoccluded masks (H, W): bit k - 1 is set where EE k is visible with its tool alone in the scene.
    """

    rgb: NDArray[np.uint8]
    depth_mm: NDArray[np.uint16]
    ee: NDArray[np.uint8]
    tool: NDArray[np.uint8]
    table: EeTable
    intrinsics: CameraIntrinsics
    scene: int
    full: NDArray[np.uint8]

    @property
    def frame(self) -> RgbdFrame:
        """The image as a camera frame, depth in metres."""
        return RgbdFrame(self.rgb, self.depth_mm.astype(np.float32) * np.float32(1e-3), self.intrinsics)


def draw(rng: np.random.Generator, split: str, count: int) -> int:
    """Draw a number of a split; each fifth number belongs to "test".

    Args:
        rng: Random generator.
        split: "train" or "test".
        count: Upper bound, excluded; a multiple of 5.

    Returns:
        The number.
    """
    five = 5 * int(rng.integers(count // 5))
    return five + 4 if split == "test" else five + int(rng.integers(4))


def pixels_of(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels of a mask, row by row.

    The same as np.nonzero, which takes ten times as long in two dimensions.

    Args:
        mask: The mask, (H, W).

    Returns:
        Rows (N,) and columns (N,).
    """
    rows, columns = np.divmod(np.flatnonzero(mask), mask.shape[1])
    return rows, columns


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
        """Content of `clouds.npz`, M clouds for `numpy.load`.

        `image`, `gt`, `count` (M,) are the index of the image, that of the EE in scene_gt, and the pixels with a depth
        in the mask, before sampling. `ends` (M,) ends each cloud in `points` (sum, 3) [m], camera frame.
        """
        where = np.array(self._where, np.int32).reshape(-1, 3)
        points = np.concatenate([np.zeros((0, 3), np.float32), *self._points])
        ends = np.cumsum([len(p) for p in self._points], dtype=np.int64)
        buffer = BytesIO()
        np.savez(buffer, image=where[:, 0], gt=where[:, 1], count=where[:, 2], ends=ends, points=points)
        return buffer.getvalue()
