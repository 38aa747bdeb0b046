"""Clouds for the training of the pose network from a data set's images, under true masks and under a detector's.

    clouds = rendered_clouds(Path("data/hard/train"), workers=2)  # or: toolee train clouds data/hard/train --out FILE

Take images that the detector was not trained on: on those it was its masks are better than they will ever be again.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.perception.evaluation.crew import Crew
from toolee_robot.perception.evaluation.examples import Case, Instance, Part, parts, read_part
from toolee_robot.perception.evaluation.shapes import telling_points
from toolee_robot.perception.pose.rendered import MOST_GUESSED, MOST_POINTS, MOST_REST, RenderedClouds
from toolee_robot.perception.segmentation import Segmenter
from toolee_robot.types import Category

NOTHING_THERE = 0.1
"""A mask that overlaps every EE of its category by less (IoU) is a negative; between this and what counts as found it
is left out."""


def rendered_clouds(
    data: Path,
    weights: Path | None = None,
    device: str = "cpu",
    workers: int = 1,
    limit: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> RenderedClouds:
    """Of a data set, or one split of it, at most `limit` images of a split. weights: folder of the detector's (the
    shipped one's if None). Raises AssetError when data or weights are missing, UserError where nothing is seen."""
    todo = parts(data, limit)
    found = []
    with Crew(partial(Segmenter.load, weights, device), workers) as crew:
        for done, part in enumerate(crew.map(of_part, todo)):
            found.append(part)
            progress(done + 1, len(todo))
    clouds = RenderedClouds.cat(found)
    if not clouds.positive.any():
        raise UserError(f"no image of {data} shows an end effector well enough: take more images")
    return clouds


def of_part(detector: Segmenter, part: Part) -> RenderedClouds:
    """The clouds of a part of a data set, under both kinds of masks."""
    examples = read_part(part, detector)
    rng = np.random.default_rng([*part.scene.name.encode()])
    rows = []
    for case in (*examples.cases["truth"], *examples.cases["predicted"]):
        instance = None if case.instance is None else examples.instances[case.instance]
        asked = case.overlap < NOTHING_THERE if instance is None else instance.target
        if asked and case.cloud.usable:
            rows.append(_cloud(case, instance, rng))
    return RenderedClouds.cat(rows)


def _cloud(case: Case, instance: Instance | None, rng: np.random.Generator) -> RenderedClouds:
    cloud = case.cloud
    kinds = (cloud.points, MOST_POINTS), (cloud.guessed, MOST_GUESSED), (cloud.rest, MOST_REST)
    points, guessed, rest = (_thinned(x, most, rng).astype(np.float32) for x, most in kinds)
    hand = None if instance is None else instance.X_camera_hand
    tells = 0
    if instance is not None and instance.category is Category.HAMMER_HEAD:
        tells = telling_points(instance, case)
    return RenderedClouds(
        points,
        guessed,
        rest,
        counts=np.array([[len(points), len(guessed), len(rest)]]),
        X_camera_ee=np.array([np.eye(4) if instance is None else instance.X_camera_ee], np.float32),
        p_camera_hand=np.array([np.full(3, np.nan) if hand is None else hand[:3, 3]], np.float32),
        category=np.array([list(Category).index(case.category)]),
        positive=np.array([instance is not None]),
        visible=np.array([len(cloud.points)]),
        tells_spin=np.array([tells]),
        occlusion=np.array([0.0 if instance is None else instance.occlusion], np.float32),
    )


def _thinned(points: Array, most: int, rng: np.random.Generator) -> Array:
    return points if len(points) <= most else points[rng.choice(len(points), most, replace=False)]
