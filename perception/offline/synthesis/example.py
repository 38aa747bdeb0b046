"""Generation of an example from its seed: scene, rendering, sensor noise, masks and poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from toolee_robot.perception.offline.dataset.catalogue import GENERATED, Catalogue, generated_tools
from toolee_robot.perception.offline.dataset.records import Example
from toolee_robot.perception.offline.dataset.spec import CONFIGS, SPLITS, DatasetSpec
from toolee_robot.perception.offline.synthesis.hard import hard_scene
from toolee_robot.perception.offline.synthesis.labels import Labels, label
from toolee_robot.perception.offline.synthesis.paper import paper_scene
from toolee_robot.perception.offline.synthesis.placement import Pool, SceneSample
from toolee_robot.perception.offline.synthesis.station import station_scene
from toolee_robot.render.renderer import Shot
from toolee_robot.render.sensors.color_camera import Photo, photograph
from toolee_robot.render.sensors.depth_sensors import random_reading
from toolee_robot.sensor_kinds import SensorKind
from toolee_robot.types import CameraIntrinsics

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
    "paper-claws": partial(paper_scene, claws=True),
}
