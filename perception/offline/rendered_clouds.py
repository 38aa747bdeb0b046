"""Training clouds of a pose network from a data set's images, under true masks and under a detector's.

    clouds = rendered_clouds(Path("data/hard/train"), workers=2)  # or: toolee train clouds data/hard/train --out FILE

Use images on which the detector was not trained, because on its training images its masks are better than on new ones.
The paper trains its estimator under true masks alone: `published` makes clouds by its own protocol.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.errors import UserError
from toolee_robot.frames import inverse
from toolee_robot.perception.detection.segmenter import Segmenter
from toolee_robot.perception.offline.dataset.spec import refuse_test_set
from toolee_robot.perception.offline.evaluation.examples import Case, Instance, Part, parts, read_part, spin_points
from toolee_robot.perception.offline.processes import ProcessMap
from toolee_robot.perception.offline.synthetic_clouds.rendered import RenderedClouds, stored
from toolee_robot.perception.pipeline import EeDetector

NOTHING_THERE = 0.1
"""A mask that overlaps every EE of its category by less (IoU) is a negative; between this and a match it is dropped."""


def rendered_clouds(
    data: Path,
    weights: Path | None = None,
    device: str = "cpu",
    workers: int = 1,
    limit: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
    true_masks: bool = False,
) -> RenderedClouds:
    """Make the clouds of a data set, or of one split.

    Args:
        data: Folder of the data set or split.
        weights: Folder of the detector's weights; None: the shipped ones.
        device: torch device that runs the detector; "cuda": each process takes one of the GPUs there are.
        workers: Number of processes.
        limit: Largest number of images per split.
        progress: Called with the number of finished scenes and their total.
        true_masks: Whether to take true masks only, without a detector.

    Returns:
        The clouds with their truth.

    Raises:
        AssetError: Data or weights are missing.
        UserError: The data are a test set, or no image shows an end effector well enough.
    """
    refuse_test_set(data)
    todo = parts(data, limit)
    found = []
    begin = _no_detector if true_masks else partial(_detector, weights, device)
    with ProcessMap(begin, workers) as processes:
        for done, part in enumerate(processes.map(clouds_of_part, todo)):
            found.append(part)
            progress(done + 1, len(todo))
    clouds = RenderedClouds.cat(found)
    if not clouds.positive.any():
        raise UserError(
            f"no image of {data} shows an end effector well enough: take more images", code="user.too_few_images"
        )
    return clouds


def clouds_of_part(detector: EeDetector | None, part: Part) -> RenderedClouds:
    """Extract the clouds of a part of a data set, under true masks and, with a detector, under predicted ones.

    Args:
        detector: The detector; None: true masks alone.
        part: The part.

    Returns:
        The clouds, camera frame [m].
    """
    examples = read_part(part, detector)
    rng = _rng(part)
    rows = []
    for case in (*examples.cases["truth"], *examples.cases.get("predicted", ())):
        instance = None if case.instance is None else examples.instances[case.instance]
        asked = case.overlap < NOTHING_THERE if instance is None else instance.target
        if asked and case.cloud.usable:
            tells = 0
            if instance is not None and instance.category.spec.spin_cues:
                tells = spin_points(instance, case)
            rows.append(_cloud(case, instance, rng, tells))
    return RenderedClouds.cat(rows)


def _detector(weights: Path | None, device: str) -> Segmenter:
    """Worker state: the detector, on one of the GPUs where "cuda" leaves the choice."""
    count = torch.cuda.device_count()
    return Segmenter.load(weights, f"cuda:{os.getpid() % count}" if device == "cuda" and count else device)


def _no_detector() -> None:
    """Worker state of a process map that needs no detector."""


def _rng(part: Part) -> np.random.Generator:
    return np.random.default_rng([*part.scene.name.encode()])


def _cloud(case: Case, instance: Instance | None, rng: np.random.Generator, tells_spin: int) -> RenderedClouds:
    points, category = (case.cloud.points, case.cloud.completed, case.cloud.rest), CATEGORIES.index(case.category)
    if instance is None:
        return replace(stored(points, category, np.eye(4), np.eye(4), 0.0, rng), positive=np.array([False]))
    X_camera_tool = instance.X_camera_ee @ inverse(instance.catalogue.tool(instance.tool).ees[instance.ee].X_tool_ee)
    row = stored(points, category, instance.X_camera_ee, X_camera_tool, instance.occlusion, rng)
    hand = row.p_camera_hand if instance.X_camera_hand is None else instance.X_camera_hand[None, :3, 3]
    return replace(row, p_camera_hand=hand.astype(np.float32), tells_spin=np.array([tells_spin]))
