"""One estimator over all clouds of a data set: what it says, beside the truth."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import AssetError, PerceptionError
from toolee_robot.frames import Array
from toolee_robot.perception.dataset.records import SHOWN_HAND
from toolee_robot.perception.evaluation import metrics
from toolee_robot.perception.evaluation.examples import Case, Examples, Instance
from toolee_robot.perception.evaluation.shapes import ee_shape, spin_is_observable
from toolee_robot.perception.pose.cloud_estimator import CloudEstimator, PoseResult, with_hand
from toolee_robot.perception.pose.estimator import PoseEstimator
from toolee_robot.perception.research.tooleenet import PaperEstimator
from toolee_robot.perception.research.tooleenet.estimator import NAME as PAPER
from toolee_robot.perception.research.tooleenet.representation import class_ambiguity
from toolee_robot.perception.trust import Trust
from toolee_robot.symmetry import SymmetryKind
from toolee_robot.types import HoldingHand


@dataclass(frozen=True, eq=False)
class Estimates:
    """One row per instance that was asked for, (N,) each; no estimate is an infinite error and confidence 0.

    category: index; held_out; angle [rad] modulo the group, position [m]; paper_angle [rad] by the paper's rule; axis
    [rad]: between the z axes, modulo the group; mssd [m] and its ratio to the diameter, mspd [px of an image 640 wide];
    spin, spin_fixed [rad]: the whole rotation error of a continuously symmetric EE without and with the hand's pose,
    NaN elsewhere; confidence, usable; spin_told: whether the view tells a hammer's spin; spin_observable: what the
    estimator says of that; class_ambiguity_right: whether its S is the class's; ms: wall-clock time of the estimate.
    """

    category: NDArray[np.int64]
    held_out: NDArray[np.bool_]
    angle: Array
    position: Array
    paper_angle: Array
    axis: Array
    mssd_share: Array
    mspd: Array
    spin: Array
    spin_fixed: Array
    confidence: Array
    usable: NDArray[np.bool_]
    spin_told: NDArray[np.bool_]
    spin_observable: Array
    class_ambiguity_right: NDArray[np.bool_]
    ms: Array

    def __len__(self) -> int:
        return len(self.category)

    def rows(self, chosen: NDArray[np.bool_]) -> Estimates:
        """The rows of a mask."""
        return Estimates(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    @property
    def made(self) -> NDArray[np.bool_]:
        """Where there is an estimate at all."""
        return np.isfinite(self.position)


@dataclass(frozen=True, eq=False)
class Ranked:
    """A detection in a ranking, by how far it is to be trusted."""

    image: int
    category: Category
    score: float
    X_camera_ee: Array
    usable: bool


def load_estimator(folder: Path | None, device: str = "cpu") -> CloudEstimator:
    """The estimator whose weights lie in a folder (the shipped one if None): ours or the paper's. Raises AssetError."""
    if folder is None or (folder / "pose.json").is_file():
        return PoseEstimator.load(folder, device)
    if (folder / f"{PAPER}.json").is_file():
        return PaperEstimator.load(folder, device)
    raise AssetError(
        f"{folder} holds neither pose.json nor {PAPER}.json: give the folder of a `toolee train pose` run (its --out)",
        code="asset.missing",
    )


def estimate_case(estimator: CloudEstimator, case: Case, seed: int) -> tuple[PoseResult | None, float]:
    """The estimate from one cloud, without the hand; None where it is refused; and the time it took [ms]."""
    points = case.tool_points if estimator.of_tool else case.cloud.points
    if not estimator.of_tool and not case.cloud.usable:
        return None, 0.0
    begun = time.perf_counter()
    try:
        result = estimator.estimate(points, case.category, case.cloud.rest, seed=seed, completed=case.cloud.completed)
    except PerceptionError:
        return None, 0.0
    return result, 1e3 * (time.perf_counter() - begun)


@dataclass(frozen=True, eq=False)
class Question:
    """One mask that an estimator is asked about. number: its seed. instance: what it shows; best: no better mask shows
    that."""

    number: int
    case: Case
    instance: Instance | None
    best: bool


@dataclass(frozen=True, eq=False)
class Answer:
    """ranked: the detection, where there is an estimate that counts. row: of `Estimates`, for an instance's best mask;
    number: of that instance."""

    ranked: Ranked | None
    number: int | None
    row: tuple[object, ...] | None


def questions(examples: Examples, masks: str, of_tool: bool) -> list[Question]:
    """All masks of that kind. of_tool: for an estimator of whole tools."""
    best = examples.of(masks)
    return [
        Question(
            number,
            # The whole tool's points are many, and may have to travel to another process.
            case if of_tool else replace(case, tool_points=_NO_POINTS),
            None if case.instance is None else examples.instances[case.instance],
            case.instance is not None and best[case.instance] is case,
        )
        for number, case in enumerate(examples.cases[masks])
    ]


def answer(estimator: CloudEstimator, trust: Trust, question: Question) -> Answer:
    """Estimate, and judge it."""
    case, instance = question.case, question.instance
    result, ms = estimate_case(estimator, case, question.number)
    ranked = row = None
    usable = False
    if result is not None:
        probability, usable, _ = trust.judge(case.score, case.tool_score, result)
        if instance is None or instance.target:
            ranked = Ranked(case.image, case.category, probability, result.X_camera_ee, usable)
    if question.best and instance is not None and _asked_for(instance, estimator.of_tool):
        row = _row(instance, case, result, usable, ms)
    return Answer(ranked, case.instance, row)


def summary(examples: Examples, of_tool: bool, answers: Iterable[Answer]) -> tuple[Estimates, list[Ranked]]:
    """Every instance that is asked for, by its best mask; and every detection, for the rankings.

    An estimator of whole tools is only asked for the first of like ends.
    """
    ranked, by_instance = [], {}
    for each in answers:
        if each.ranked is not None:
            ranked.append(each.ranked)
        if each.row is not None:
            by_instance[each.number] = each.row
    rows = [
        by_instance.get(number) or _row(instance, None, None, False, 0.0)
        for number, instance in enumerate(examples.instances)
        if _asked_for(instance, of_tool)
    ]
    return Estimates(*(np.array([row[k] for row in rows], kind) for k, kind in enumerate(_TYPES))), ranked


def _asked_for(instance: Instance, of_tool: bool) -> bool:
    return instance.target and (instance.first_end or not of_tool)


_NO_POINTS = np.empty((0, 3))
_TYPES = (int, bool, *[float] * 9, bool, bool, float, bool, float)
_INF = float("inf")


def _row(
    instance: Instance, case: Case | None, result: PoseResult | None, usable: bool, ms: float
) -> tuple[object, ...]:
    category, X_true = instance.category, instance.X_camera_ee
    index = CATEGORIES.index(category)
    observable = case is not None and case.cloud.usable and spin_is_observable(instance, case)
    if result is None:
        nan = float("nan")
        errors = (_INF, _INF, _INF, _INF, _INF, _INF, nan, nan)
        return (index, instance.held_out, *errors, 0.0, False, observable, nan, False, ms)
    X, group = result.X_camera_ee, category.symmetry
    shape = ee_shape(instance.catalogue, instance.tool, instance.ee)
    K = instance.intrinsics
    spin = spin_fixed = float("nan")
    if group.kind is SymmetryKind.CINF and instance.X_camera_hand is not None:
        spin = metrics.paper_rule_angle(X[:3, :3], X_true[:3, :3], np.zeros(3))
        fixed = with_hand(result, HoldingHand(instance.X_camera_hand, SHOWN_HAND.grasp.R_hand_tool)).X_camera_ee
        spin_fixed = metrics.paper_rule_angle(fixed[:3, :3], X_true[:3, :3], np.zeros(3))
    said = np.asarray(result.ambiguous) > 0.5
    return (
        index,
        instance.held_out,
        group.rotation_error(X[:3, :3], X_true[:3, :3]),
        float(np.linalg.norm(X[:3, 3] - X_true[:3, 3])),
        metrics.paper_rule_angle(X[:3, :3], X_true[:3, :3], result.ambiguous),
        metrics.axis_angle(X[:3, :3], X_true[:3, :3], group),
        metrics.mssd(X, X_true, shape.vertices, group) / shape.diameter,
        metrics.mspd(X, X_true, shape.vertices, group, K.matrix) * 640 / K.width,
        spin,
        spin_fixed,
        result.confidence,
        usable,
        observable,
        result.hypotheses.spin_observable,
        bool((said == class_ambiguity()[index].numpy().astype(bool)).all()),
        ms,
    )
