"""One example from its seed: scene, rendering, sensor noise, masks and poses."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array, inverse
from toolee_robot.perception.dataset.hard import hard_scene
from toolee_robot.perception.dataset.placement import PlacedTool, Pool, SceneSample
from toolee_robot.perception.dataset.records import CATEGORIES, HEIGHT, MAX_EES, WIDTH, EeTable, Example
from toolee_robot.perception.dataset.station import station_scene
from toolee_robot.render import Body
from toolee_robot.render.photo import Photo, photograph
from toolee_robot.render.renderer import cast, render
from toolee_robot.render.sensor import DepthNoise, measure_depth
from toolee_robot.tools import ToolKind, ee_radius
from toolee_robot.types import CameraIntrinsics

BLOCK = 64
"""Consecutive examples that share a pool of tools and grasps."""
EMPTY_SHARE, STATION_SHARE = 0.10, 0.30
_KINDS = tuple(ToolKind)
_SPLITS = ("train", "test")


@lru_cache(maxsize=2)
def _pool(seed: int, block: int, split: str) -> Pool:
    return Pool.random(np.random.default_rng([seed, _SPLITS.index(split), 0, block]), split)


def make_example(seed: int, index: int, split: str = "train") -> Example:
    """Example `index` of the data set `seed`; depends on nothing else. split: "train" or "test" (held-out tools)."""
    sample, rng = make_scene(seed, index, split)
    rendering = render(
        sample.scene,
        sample.intrinsics,
        sample.X_world_camera,
        exposure=float(rng.uniform(0.75, 1.35)),
        auto_exposure=float(rng.uniform(0.3, 1.0)),
    )
    noise = DepthNoise.random(rng)
    depth = measure_depth(rendering.depth, rendering.cos_incidence, rendering.shininess, sample.intrinsics, noise, rng)
    rgb = photograph(rendering.rgb, Photo.random(rng), rng)
    ee, tool, table = label(sample, rendering.depth, rendering.body_ids)
    depth_mm = np.clip(np.round(depth * 1000.0), 0, 65535).astype(np.uint16)
    return Example(rgb, depth_mm, ee, tool, table, sample.intrinsics, sample.kind)


def make_scene(seed: int, index: int, split: str = "train") -> tuple[SceneSample, np.random.Generator]:
    """The scene of an example, and the generator that its camera and sensor continue with."""
    rng = np.random.default_rng([seed, _SPLITS.index(split), 1, index])
    return _scene(rng, _pool(seed, index // BLOCK, split)), rng


def _scene(rng: np.random.Generator, pool: Pool) -> SceneSample:
    chance = rng.random()
    if chance < EMPTY_SHARE:
        return hard_scene(rng, pool, with_tools=False)
    if chance < EMPTY_SHARE + STATION_SHARE:
        for _ in range(20):
            sample = station_scene(rng, pool)
            if sample is not None:
                return sample
    return hard_scene(rng, pool)


def label(
    sample: SceneSample, depth: NDArray[np.float32], body_ids: NDArray[np.int16]
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], EeTable]:
    """EE ids and tool ids (H, W), and the table of the EEs, from a scene's exact depth [m] and body ids."""
    tool_ids = np.where((body_ids >= 1) & (body_ids <= len(sample.tools)), body_ids, 0).astype(np.uint8)
    ee_ids = np.zeros(tool_ids.shape, np.uint8)
    table = EeTable.empty()
    X_camera_world = inverse(sample.X_world_camera)
    next_id = 1
    for placed in sample.tools:
        X_camera_tool = X_camera_world @ placed.X_world_tool
        ees = placed.tool.ees[: MAX_EES + 1 - next_id]
        Xs_camera_ee = [X_camera_tool @ ee.X_tool_ee for ee in ees]
        radii = np.array([ee_radius(ee.category) for ee in ees])
        _number(ee_ids, depth, tool_ids == placed.body_id, Xs_camera_ee, radii, next_id, sample.intrinsics)
        alone = _alone(placed, sample, Xs_camera_ee, radii)
        for k, ee in enumerate(ees):
            row = next_id - 1 + k
            table.category[row] = CATEGORIES.index(ee.category) + 1
            table.tool[row] = placed.body_id
            table.kind[row] = _KINDS.index(placed.tool.kind)
            table.seed[row] = placed.tool.seed
            table.X_camera_ee[row] = Xs_camera_ee[k]
            table.X_camera_tool[row] = X_camera_tool
            if placed.X_world_hand is not None:
                table.X_camera_hand[row] = X_camera_world @ placed.X_world_hand
            table.mirrored[row] = placed.mirrored
            table.visible[row] = np.count_nonzero(ee_ids == next_id + k)
            table.unoccluded[row] = alone[k]
        next_id += len(ees)
    return ee_ids, tool_ids, table


def _number(
    ids: NDArray[np.uint8],
    depth: NDArray[np.float32],
    mask: NDArray[np.bool_],
    Xs_camera_ee: list[Array],
    radii: Array,
    first_id: int,
    intrinsics: CameraIntrinsics,
) -> None:
    """Write first_id + k into `ids` at the tool's pixels inside of sphere k (the relatively nearer one's)."""
    rows, columns = np.nonzero(mask)
    if not len(rows):
        return
    z = depth[rows, columns]
    points = np.column_stack(
        [(columns - intrinsics.cx) / intrinsics.fx * z, (rows - intrinsics.cy) / intrinsics.fy * z, z]
    )
    relative = np.stack(
        [np.linalg.norm(points - X[:3, 3], axis=1) / r for X, r in zip(Xs_camera_ee, radii, strict=True)]
    )
    nearest = relative.argmin(axis=0)
    inside = relative[nearest, np.arange(len(rows))] <= 1.0
    ids[rows[inside], columns[inside]] = first_id + nearest[inside]


def _alone(placed: PlacedTool, sample: SceneSample, Xs_camera_ee: list[Array], radii: Array) -> list[int]:
    """How many pixels each EE's mask would have if nothing but its tool were there."""
    own: list[Body] = [body for body in sample.scene.bodies if body.body_id == placed.body_id]
    region = _region(Xs_camera_ee, radii, sample.intrinsics)
    counts = [0] * len(radii)
    if region is None:
        return counts
    depth, _ = cast(own, sample.intrinsics, sample.X_world_camera, region)
    ids = np.zeros(depth.shape, np.uint8)
    x0, y0, _, _ = region
    K = sample.intrinsics
    shifted = CameraIntrinsics(K.fx, K.fy, K.cx - x0, K.cy - y0, depth.shape[1], depth.shape[0])
    _number(ids, depth, depth > 0, Xs_camera_ee, radii, 1, shifted)
    return [int(np.count_nonzero(ids == k + 1)) for k in range(len(radii))]


def _region(Xs_camera_ee: list[Array], radii: Array, intrinsics: CameraIntrinsics) -> tuple[int, int, int, int] | None:
    """x0, y0, x1, y1 [px] around the EEs' spheres, cut with the image; None where nothing is left."""
    boxes = []
    for X, radius in zip(Xs_camera_ee, radii, strict=True):
        x, y, z = X[:3, 3]
        if z < radius + 0.05:
            return 0, 0, WIDTH, HEIGHT
        # A little more than the sphere's outline, which perspective stretches off the axis.
        half = 1.3 * radius * intrinsics.fx / (z - radius)
        u, v = intrinsics.fx * x / z + intrinsics.cx, intrinsics.fy * y / z + intrinsics.cy
        boxes.append([u - half, v - half, u + half, v + half])
    x0, y0 = np.floor(np.clip(np.min(boxes, axis=0)[:2], 0, [WIDTH, HEIGHT])).astype(int)
    x1, y1 = np.ceil(np.clip(np.max(boxes, axis=0)[2:], 0, [WIDTH, HEIGHT])).astype(int)
    return (int(x0), int(y0), int(x1), int(y1)) if x1 > x0 and y1 > y0 else None
