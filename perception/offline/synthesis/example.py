"""Generation of an example from its seed: scene, rendering, sensor noise, masks and poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from toolee_robot.depth_noise import SensorKind
from toolee_robot.frames import Array, inverse
from toolee_robot.perception.offline.dataset.catalogue import GENERATED, Catalogue, generated_tools, number_of
from toolee_robot.perception.offline.dataset.instances import object_id
from toolee_robot.perception.offline.dataset.records import MAX_EES, EeTable, Example, pixels_of
from toolee_robot.perception.offline.dataset.spec import CONFIGS, SPLITS, DatasetSpec
from toolee_robot.perception.offline.synthesis.hard import hard_scene
from toolee_robot.perception.offline.synthesis.placement import Pool, SceneSample
from toolee_robot.perception.offline.synthesis.station import paper_scene, station_scene
from toolee_robot.render.depth_sensors import Photo, photograph, random_reading
from toolee_robot.render.renderer import Shot
from toolee_robot.types import CameraIntrinsics

Labels = tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8], EeTable]
"""EE ids, tool ids and unoccluded masks (H, W), and the table of the EEs."""


def label(sample: SceneSample, shot: Shot) -> Labels:
    """Label a scene from its exact depth and body ids.

    Args:
        sample: The scene.
        shot: The scene as the camera sees it.

    Returns:
        EE ids, tool ids and unoccluded masks (H, W) as in `Example`, and the table of the EEs.
    """
    depth, body_ids = shot.depth, shot.body_ids
    tool_ids, ee_ids, full = (np.zeros(body_ids.shape, np.uint8) for _ in range(3))
    tool_rows, tool_columns = pixels_of((body_ids >= 1) & (body_ids <= len(sample.tools)))
    shown = body_ids[tool_rows, tool_columns]
    tool_ids[tool_rows, tool_columns] = shown
    table = EeTable.empty()
    X_camera_world = inverse(sample.X_world_camera)
    next_id = 1
    for placed in sample.tools:
        X_camera_tool = X_camera_world @ placed.X_world_tool
        ees = placed.tool.ees[: MAX_EES + 1 - next_id]
        Xs_camera_ee = [X_camera_tool @ ee.X_tool_ee for ee in ees]
        reach = _Reach(Xs_camera_ee, np.array([ee.category.spec.radius for ee in ees]), sample.circle)
        of_tool = shown == placed.body_id
        rows, columns, own = reach.within(depth, tool_rows[of_tool], tool_columns[of_tool], sample.intrinsics)
        ee_ids[rows, columns] = next_id + own
        visible = np.bincount(own, minlength=len(ees))
        alone = _alone(shot, placed.body_id, reach, sample.intrinsics, full, next_id)
        for k, ee in enumerate(ees):
            row = next_id - 1 + k
            table.category[row] = ee.category.spec.class_id
            table.tool[row] = placed.body_id
            table.obj_id[row] = object_id(number_of(placed.tool), k)
            table.X_camera_ee[row] = Xs_camera_ee[k]
            table.X_camera_tool[row] = X_camera_tool
            if placed.X_world_hand is not None:
                table.X_camera_hand[row] = X_camera_world @ placed.X_world_hand
            table.mirrored[row] = placed.mirrored
            table.visible[row] = visible[k]
            table.unoccluded[row] = alone[k]
        next_id += len(ees)
    return ee_ids, tool_ids, full, table


class _Reach:
    """Assignment of the pixels of one tool to its EEs, by a sphere (or a circle) about each EE origin."""

    def __init__(self, Xs_camera_ee: list[Array], radii: Array, circle: float | None) -> None:
        self.Xs_camera_ee, self.radii, self.circle = Xs_camera_ee, radii, circle

    def within(
        self,
        depth: NDArray[np.float32],
        rows: NDArray[np.int64],
        columns: NDArray[np.int64],
        intrinsics: CameraIntrinsics,
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Select the pixels of the tool that belong to an EE: rows, columns and index of the relatively nearest EE."""
        K = intrinsics
        if self.circle is None:
            z = depth[rows, columns].astype(np.float64)
            x, y = (columns - K.cx) / K.fx * z, (rows - K.cy) / K.fy * z
            origins = [X[:3, 3].tolist() for X in self.Xs_camera_ee]
            distances = [np.sqrt((x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2) for u, v, w in origins]
            relative = np.stack([d / r for d, r in zip(distances, self.radii, strict=True)])
        else:
            centres = [X[:2, 3] / X[2, 3] * [K.fx, K.fy] + [K.cx, K.cy] for X in self.Xs_camera_ee]
            relative = np.stack([np.hypot(columns - u, rows - v) for u, v in centres]) / self.circle
        inside = np.flatnonzero(relative.min(axis=0) <= 1.0)
        return rows[inside], columns[inside], relative[:, inside].argmin(axis=0)

    def region(self, K: CameraIntrinsics) -> tuple[int, int, int, int] | None:
        """Bounding box x0, y0, x1, y1 [px] of the EEs, clipped to the image; None if it is empty."""
        boxes = []
        for X, radius in zip(self.Xs_camera_ee, self.radii, strict=True):
            z = X[2, 3]
            if z < radius + 0.05:
                return 0, 0, K.width, K.height
            # Margin on the outline of the sphere, which perspective stretches off the optical axis.
            half = 1.3 * radius * K.fx / (z - radius) if self.circle is None else self.circle + 1.0
            u, v = K.project(X[:3, 3])
            boxes.append([u - half, v - half, u + half, v + half])
        x0, y0 = np.floor(np.clip(np.min(boxes, axis=0)[:2], 0, [K.width, K.height])).astype(int)
        x1, y1 = np.ceil(np.clip(np.max(boxes, axis=0)[2:], 0, [K.width, K.height])).astype(int)
        return (int(x0), int(y0), int(x1), int(y1)) if x1 > x0 and y1 > y0 else None


def _alone(
    shot: Shot, body_id: int, reach: _Reach, K: CameraIntrinsics, full: NDArray[np.uint8], first_id: int
) -> NDArray[np.int64]:
    """Number of pixels of each unoccluded EE mask, with the tool alone in the scene; sets their bits in `full`."""
    region = reach.region(K)
    if region is None:
        return np.zeros(len(reach.radii), np.int64)
    depth = shot.depth_of(body_id, region)
    x0, y0, _, _ = region
    shifted = CameraIntrinsics(K.fx, K.fy, K.cx - x0, K.cy - y0, depth.shape[1], depth.shape[0])
    rows, columns, ees = reach.within(depth, *pixels_of(depth > 0), shifted)
    full[y0 + rows, x0 + columns] |= (1 << (first_id - 1 + ees)).astype(np.uint8)
    return np.bincount(ees, minlength=len(reach.radii))


EMPTY_SHARE, STATION_SHARE = 0.10, 0.30
"""Shares of scenes without tools and of station scenes in the configuration "hard"."""
_ATTEMPTS = 50


@lru_cache(maxsize=2)
def _pool(seed: int, block: int, split: str, catalogue: Catalogue) -> Pool:
    return Pool.random(np.random.default_rng([seed, SPLITS.index(split), 0, block]), split, catalogue)


@dataclass(frozen=True)
class Series:
    """A series of examples; an example is determined by its series and index.

    Attributes:
        seed: Random seed.
        split: "train" or "test" (held-out tools).
        config: Scene configuration, one of `spec.CONFIGS`.
        block: Number of consecutive examples that share a pool of tools.
        catalogue: Catalogue of the tools.
        sensor: Kind of the depth camera in "hard".
    """

    seed: int
    split: str = "train"
    config: str = "hard"
    block: int = 32
    catalogue: Catalogue = GENERATED
    sensor: SensorKind = "time-of-flight"


def make_example(series: Series, index: int, device: str = "cpu") -> Example:
    """Generate an example of a series.

    Args:
        series: The series.
        index: Index of the example in it.
        device: "cpu" or "cuda".

    Returns:
        The example, with sensor effects.
    """
    taken = render_example(series, index, device)
    sample, shot, rng = taken.sample, taken.shot, taken.rng
    ee, tool, full, table = taken.labels
    if series.config == "hard":
        exposure, automatic = float(rng.uniform(0.75, 1.35)), float(rng.uniform(0.3, 1.0))
        depth, rgb = expose(shot, sample.intrinsics, exposure, automatic, rng, series.sensor)
    else:
        rgb, depth = shot.develop(exposure=1.0, auto_exposure=1.0).rgb.numpy(), shot.depth
    return Example(rgb, millimetres(depth), ee, tool, table, sample.intrinsics, sample.kind, full)


def millimetres(depth: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Depth as a data set holds it.

    Args:
        depth: Depth, (H, W) [m].

    Returns:
        Depth, (H, W) [mm].
    """
    return np.minimum(depth * np.float32(1000.0) + np.float32(0.5), np.float32(65535.0)).astype(np.uint16)


def expose(
    shot: Shot,
    intrinsics: CameraIntrinsics,
    exposure: float,
    automatic: float,
    rng: np.random.Generator,
    sensor: SensorKind = "time-of-flight",
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Apply a random depth sensor and a random colour camera to a rendered scene.

    Args:
        shot: The rendered scene.
        intrinsics: Intrinsics of the camera.
        exposure: Factor on the linear colour.
        automatic: Strength of the automatic exposure, in [0, 1].
        rng: Random generator.
        sensor: Kind of the depth camera.

    Returns:
        Depth (H, W) [m] and RGB (H, W, 3).
    """
    image = shot.develop(exposure=exposure, auto_exposure=automatic)
    depth = random_reading(sensor, image, intrinsics, rng, shot.device)
    return depth, photograph(image.rgb, Photo.random(rng), rng, shot.device)


@dataclass(frozen=True, eq=False)
class RenderedExample:
    """An example before sensor effects.

    Attributes:
        sample: Scene, camera and tools.
        shot: The rendered scene.
        labels: EE ids, tool ids, unoccluded masks and table of the EEs.
        rng: Random generator for the sensor effects.
    """

    sample: SceneSample
    shot: Shot
    labels: Labels
    rng: np.random.Generator


def render_example(series: Series, index: int, device: str = "cpu") -> RenderedExample:
    """Generate example `index` of a series without sensor effects.

    A scene with tools but without a target (`EeTable.targets`) is rejected and drawn again, up to 50 times.

    Args:
        series: The series.
        index: Index of the example in it.
        device: "cpu" or "cuda".

    Returns:
        The scene, its rendering and its labels.
    """
    seed, split, config = series.seed, SPLITS.index(series.split), CONFIGS.index(series.config)
    pool = _pool(series.seed, index // series.block, series.split, series.catalogue)
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, split, 1, index, config, attempt])
        sample = _SCENES[series.config](rng, pool)
        shot = Shot(sample.scene, sample.intrinsics, sample.X_world_camera, device)
        labels = label(sample, shot)
        if not sample.tools or labels[3].targets.any():
            break
    return RenderedExample(sample, shot, labels, rng)


def examples_of(
    spec: DatasetSpec,
    split: str,
    first: int,
    last: int,
    catalogue: Catalogue | None = None,
) -> Iterator[Example]:
    """Generate examples first .. last - 1 of a split of a data set.

    Args:
        spec: Specification of the data set.
        split: "train" or "test".
        first: Index of the first example.
        last: Index after the last example.
        catalogue: Tools of the data set; None: the generated ones.

    Yields:
        The examples.
    """
    catalogue = catalogue or generated_tools(spec.kinds)
    series = Series(spec.seed, split, spec.config, spec.scene_size, catalogue, spec.sensor)
    for i in range(first, last):
        yield make_example(series, i, spec.device)


def _hard_scene(rng: np.random.Generator, pool: Pool) -> SceneSample:
    chance = rng.random()
    if chance < EMPTY_SHARE:
        return hard_scene(rng, pool, with_tools=False)
    if chance < EMPTY_SHARE + STATION_SHARE:
        for _ in range(20):
            sample = station_scene(rng, pool)
            if sample is not None:
                return sample
    return hard_scene(rng, pool)


_SCENES: dict[str, Callable[[np.random.Generator, Pool], SceneSample]] = {
    "paper": paper_scene,
    "hard": _hard_scene,
}
