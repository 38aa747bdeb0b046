"""Fit the trust model of a detector with a pose estimator, on frames with tools and on rendered ones without.

    report = fit_trust(Path("data/hard-trust/train"), workers=2)  # or: toolee train trust --data data/hard-trust/train

Use data on which neither network was trained and on which nothing is reported. Which poses are right is decided by
`right_poses`, as in the report of `toolee evaluate pose`. The threshold is the lowest above which PRECISION of the
poses are right and at which TRUE_NEGATIVE_RATE of the frames without a tool give none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.perception import weight_files
from toolee_robot.perception.detection.segmenter import Segmenter
from toolee_robot.perception.offline.dataset.catalogue import Catalogue
from toolee_robot.perception.offline.dataset.spec import generated_catalogue_of, refuse_test_set
from toolee_robot.perception.offline.evaluation.estimates import Ranked, estimate_case
from toolee_robot.perception.offline.evaluation.examples import Examples, Part, parts, read_part
from toolee_robot.perception.offline.evaluation.pose import right_poses
from toolee_robot.perception.offline.evaluation.run import empty_frame
from toolee_robot.perception.offline.processes import ProcessMap
from toolee_robot.perception.pipeline import ToolPerception
from toolee_robot.perception.pose import CloudEstimator, PoseEstimator, confidence
from toolee_robot.perception.trust import FEATURES, Trust, features

PRECISION = 0.95
"""Wanted share of right poses among the usable ones."""
TRUE_NEGATIVE_RATE = 0.993
"""Wanted share of frames without a tool that give no usable pose; above the 99 % that are required, to leave a margin
for other frames.
"""
_RIDGE = 3.0
"""Ridge penalty of the fit."""
_HIGHEST = 0.95
"""Upper bound of the threshold."""


def networks(folder: Path | None) -> ToolPerception:
    """The networks of a folder, None: the shipped ones; without trust. Raises AssetError if they are missing."""
    return ToolPerception(Segmenter.load(folder), PoseEstimator.load(folder))


@dataclass(frozen=True, eq=False)
class TrustSamples:
    """Training samples of the trust model, one row per pose.

    Attributes:
        x: Features (N, F) of the model.
        right: 1 where the pose is right, (N,).
        usable: 1 where the pose's own confidence calls it usable, (N,).
        images: Number of images they come from.
    """

    x: Array
    right: Array
    usable: Array
    images: int


def collect(seed: int, catalogue: Catalogue, perception: ToolPerception, part: Part | int) -> TrustSamples:
    """Samples from a part of a data set, or from a rendered frame without a tool.

    Args:
        seed: Seed of rendered frames.
        catalogue: Tools of the scenes of rendered frames.
        perception: Detector and pose estimator.
        part: The part of the data set, or the number of the frame to render.

    Returns:
        The samples.
    """
    if isinstance(part, Part):
        return _tool_samples(perception.pose, read_part(part, perception.detector))
    rows = []
    assert isinstance(perception.pose, PoseEstimator)
    sure = perception.pose.calibration.confidence.threshold
    for e in perception.estimate(empty_frame(seed, part, catalogue, "train")):
        if np.isfinite(e.X_camera_ee).all():
            d = e.detection
            rows.append((features(e.confidence, d.score, d.tool_score, d.category), 0.0, e.confidence >= sure))
    return _samples(rows, 1)


def _tool_samples(estimator: CloudEstimator, examples: Examples) -> TrustSamples:
    found = []
    for number, case in enumerate(examples.cases["predicted"]):
        instance = None if case.instance is None else examples.instances[case.instance]
        result, _ = estimate_case(estimator, case, number)
        if result is not None and (instance is None or instance.target):
            # The unfitted model (odds multiplied) ranks the poses.
            score, _, _ = Trust().judge(case.score, case.tool_score, result)
            ranked = Ranked(case.image, case.category, score, result.X_camera_ee, result.usable)
            found.append((ranked, features(result.confidence, case.score, case.tool_score, case.category)))
    right, counted = right_poses(examples.instances, [ranked for ranked, _ in found])
    judged = zip(found, right.tolist(), counted.tolist(), strict=True)
    return _samples([(x, float(ok), ranked.usable) for (ranked, x), ok, counts in judged if counts], examples.images)


def _samples(rows: list[tuple[Array, float, bool]], images: int) -> TrustSamples:
    x = np.array([row[0] for row in rows]).reshape(-1, len(FEATURES))
    right, usable = (np.array([row[k] for row in rows], dtype=np.float64) for k in (1, 2))
    return TrustSamples(x, right, usable, images)


def fit(tools: list[TrustSamples], empty: list[TrustSamples]) -> tuple[Trust, dict[str, float]]:
    """Fit the trust model.

    Args:
        tools: Samples from images with tools.
        empty: Samples from frames without a tool, one record per frame.

    Returns:
        The model, and its figures on the samples of the fit.

    Raises:
        UserError: There are fewer than 50 right poses, or no frame without a tool.
    """
    x = np.concatenate([each.x for each in (*tools, *empty)])
    right = np.concatenate([each.right for each in (*tools, *empty)])
    if right.sum() < 50 or not empty:
        raise UserError(
            "too few poses are right, or no frame is without a tool: take more images", code="user.too_few_images"
        )
    model = confidence.fit(x, right, PRECISION, _RIDGE, FEATURES)
    loudest = np.array([_max_probability(model, each) for each in empty])
    needed = float(np.quantile(loudest, TRUE_NEGATIVE_RATE, method="higher")) + 1e-6
    model = replace(model, threshold=min(max(model.threshold, needed), _HIGHEST))
    p = model.probability(np.concatenate([each.x for each in tools]))
    passed = (p >= model.threshold) & (np.concatenate([each.usable for each in tools]) > 0)
    of_tools = np.concatenate([each.right for each in tools])
    report = {
        "images": sum(each.images for each in tools),
        "poses": len(p),
        "frames_without_a_tool": len(empty),
        "usable_right": float(of_tools[passed].mean()) if passed.any() else float("nan"),
        "right_usable": float(passed[of_tools > 0].mean()),
        "quiet": float((loudest < model.threshold).mean()),
    }
    return Trust(model), report


def _max_probability(model: confidence.ConfidenceModel, samples: TrustSamples) -> float:
    """Largest probability of a pose that is usable by its own confidence; 0 without one."""
    p = model.probability(samples.x)[samples.usable > 0]
    return float(p.max()) if len(p) else 0.0


def fit_trust(
    data: Path,
    folder: Path | None = None,
    frames: int = 1000,
    seed: int = 0,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> dict[str, float]:
    """Collect samples, fit the trust model, and write trust.json.

    Args:
        data: Folder of a data set or split.
        folder: Folder that holds the weights of both networks and gets trust.json; None: the shipped ones.
        frames: Number of rendered frames without a tool.
        seed: Seed of these frames.
        workers: Number of processes.
        progress: Called with the number of finished parts and their total.

    Returns:
        Figures on the samples of the fit.

    Raises:
        AssetError: Data or weights are missing.
        UserError: The data are a test set, or there are too few images.
    """
    refuse_test_set(data)
    networks(folder)  # missing weights are reported here, not by a worker that dies
    todo = [*parts(data), *range(frames)]
    found = []
    with ProcessMap(partial(networks, folder), workers) as processes:
        for each in processes.map(partial(collect, seed, generated_catalogue_of(data)), todo):
            found.append(each)
            progress(len(found), len(todo))
    count = len(todo) - frames
    trust, report = fit(found[:count], found[count:])
    about = {"data": "/".join(data.resolve().parts[-2:]), "seed": seed}
    trust.save(folder or weight_files.WEIGHTS_DIR, {**report, **about})
    return report
