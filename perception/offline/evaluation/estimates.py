"""Estimates of one estimator on all clouds of a data set, with their errors."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import AssetError, PerceptionError
from toolee_robot.frames import Array
from toolee_robot.perception.offline.dataset.records import SHOWN_HAND
from toolee_robot.perception.offline.evaluation import metrics
from toolee_robot.perception.offline.evaluation.examples import Case, Examples, Instance
from toolee_robot.perception.pose.cloud_estimator import CloudEstimator, PoseResult, with_hand
from toolee_robot.perception.pose.estimator import PoseEstimator
from toolee_robot.perception.pose.tooleenet import PaperEstimator
from toolee_robot.perception.pose.tooleenet.estimator import NAME as PAPER
from toolee_robot.perception.trust import Trust
from toolee_robot.symmetry import SymmetryKind
from toolee_robot.types import HoldingHand


@dataclass(frozen=True, eq=False)
class Estimates:
    """One row per instance that is asked for, N in all; a missing estimate has infinite errors and confidence 0.

    Attributes:
        category: Index of the category, (N,).
        held_out: Whether training never showed the tool, (N,) bool.
        angle: Rotation error modulo the group, (N,) [rad].
        position: Position error, (N,) [m].
        paper_angle: Rotation error by the paper's rule, (N,) [rad].
        axis: Angle between the z axes, modulo the group, (N,) [rad].
        spin: Whole rotation error of a continuously symmetric EE without the hand's pose, NaN elsewhere, (N,) [rad].
        spin_fixed: The same with the hand's pose, (N,) [rad].
        confidence: In [0, 1], (N,).
        usable: (N,) bool.
        ms: Wall-clock time of the estimate, (N,) [ms].
    """

    category: NDArray[np.int64]
    held_out: NDArray[np.bool_]
    angle: Array
    position: Array
    paper_angle: Array
    axis: Array
    spin: Array
    spin_fixed: Array
    confidence: Array
    usable: NDArray[np.bool_]
    ms: Array

    def __len__(self) -> int:
        return len(self.category)

    def rows(self, chosen: NDArray[np.bool_]) -> Estimates:
        """The rows of a mask (N,) bool."""
        return Estimates(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    @property
    def made(self) -> NDArray[np.bool_]:
        """Where there is an estimate, (N,) bool."""
        return np.isfinite(self.position)


@dataclass(frozen=True, eq=False)
class Ranked:
    """A pose in the ranking by score.

    Attributes:
        image: Number of the image.
        category: Claimed category.
        score: Trust in the pose.
        X_camera_ee: The pose, 4x4.
        usable: Whether it may be acted on.
    """

    image: int
    category: Category
    score: float
    X_camera_ee: Array
    usable: bool


def load_estimator(folder: Path | None, device: str = "cpu", *, whole_tools: bool = False) -> CloudEstimator:
    """Load an estimator, the default or the paper's, by the weights in a folder.

    Args:
        folder: Folder of a training; None: the shipped weights.
        device: torch device.
        whole_tools: Whether weights that take whole tools are wanted, too.

    Returns:
        The estimator.

    Raises:
        AssetError: The weights are missing or unreadable.
        UserError: They take whole tools, unasked (`user.paper_column`).
    """
    if folder is None or (folder / "pose.json").is_file():
        return PoseEstimator.load(folder, device)
    if (folder / f"{PAPER}.json").is_file():
        return (PaperEstimator.load if whole_tools else PaperEstimator.load_for_job)(folder, device)
    raise AssetError(
        f"{folder} holds neither pose.json nor {PAPER}.json: "
        "give the --out of `toolee train pose` or `toolee train paper`",
        code="asset.missing",
    )


def estimate_case(estimator: CloudEstimator, case: Case, seed: int) -> tuple[PoseResult | None, float]:
    """Estimate the pose from one cloud, without the hand.

    Args:
        estimator: The estimator.
        case: The mask with its cloud.
        seed: Seed of the sampling.

    Returns:
        The estimate, None where it is refused, and its wall-clock time [ms].
    """
    points = case.cloud.points
    if not case.cloud.usable:
        return None, 0.0
    begun = time.perf_counter()
    try:
        result = estimator.estimate(points, case.category, case.cloud.rest, seed=seed, completed=case.cloud.completed)
    except PerceptionError:
        return None, 0.0
    return result, 1e3 * (time.perf_counter() - begun)


@dataclass(frozen=True, eq=False)
class Question:
    """A mask whose pose an estimator is asked for.

    Attributes:
        number: Number of the mask; seed of the sampling.
        case: The mask with its cloud.
        instance: What it shows; None for a false alarm.
        best: Whether it is the best mask of that instance.
    """

    number: int
    case: Case
    instance: Instance | None
    best: bool


@dataclass(frozen=True, eq=False)
class Answer:
    """Result of a question.

    Attributes:
        ranked: The pose for the ranking; None without one that counts.
        number: Index of the instance; None for a false alarm.
        row: Row of `Estimates`, for an instance's best mask.
    """

    ranked: Ranked | None
    number: int | None
    row: tuple[object, ...] | None


def questions(examples: Examples, masks: str) -> list[Question]:
    """The questions about all masks of one kind.

    Args:
        examples: The data set.
        masks: Kind of mask, "truth" or "predicted".

    Returns:
        One question per mask.
    """
    best = examples.of(masks)
    return [
        Question(
            number,
            case,
            None if case.instance is None else examples.instances[case.instance],
            case.instance is not None and best[case.instance] is case,
        )
        for number, case in enumerate(examples.cases[masks])
    ]


def answer(estimator: CloudEstimator, trust: Trust, question: Question) -> Answer:
    """Estimate a question's pose and judge it.

    Args:
        estimator: The estimator.
        trust: Its trust model.
        question: The mask.

    Returns:
        The pose for the ranking, and the row of the instance.
    """
    case, instance = question.case, question.instance
    result, ms = estimate_case(estimator, case, question.number)
    ranked = row = None
    usable = False
    if result is not None:
        probability, usable, _ = trust.judge(case.score, case.tool_score, result)
        if instance is None or instance.target:
            ranked = Ranked(case.image, case.category, probability, result.X_camera_ee, usable)
    if question.best and instance is not None and instance.target:
        row = _row(instance, result, usable, ms)
    return Answer(ranked, case.instance, row)


def summary(examples: Examples, answers: Iterable[Answer]) -> tuple[Estimates, list[Ranked]]:
    """Join the answers: every instance that is asked for by its best mask, and every pose for the rankings.

    Args:
        examples: The data set.
        answers: The answers, in any order.

    Returns:
        The estimates, and the poses for the rankings.
    """
    ranked, by_instance = [], {}
    for each in answers:
        if each.ranked is not None:
            ranked.append(each.ranked)
        if each.row is not None:
            by_instance[each.number] = each.row
    rows = [
        by_instance.get(number) or _row(instance, None, False, 0.0)
        for number, instance in enumerate(examples.instances)
        if instance.target
    ]
    return Estimates(*(np.array([row[k] for row in rows], kind) for k, kind in enumerate(_TYPES))), ranked


_TYPES = (int, bool, *[float] * 7, bool, float)
_INF = float("inf")


def _row(instance: Instance, result: PoseResult | None, usable: bool, ms: float) -> tuple[object, ...]:
    category, X_true = instance.category, instance.X_camera_ee
    index = CATEGORIES.index(category)
    if result is None:
        nan = float("nan")
        errors = (_INF, _INF, _INF, _INF, nan, nan)
        return (index, instance.held_out, *errors, 0.0, False, ms)
    X, group = result.X_camera_ee, category.symmetry
    spin = spin_fixed = float("nan")
    if group.kind is SymmetryKind.CINF and instance.X_camera_hand is not None:
        spin = metrics.paper_rule_angle(X[:3, :3], X_true[:3, :3], np.zeros(3))
        fixed = with_hand(result, HoldingHand(instance.X_camera_hand, SHOWN_HAND.grasp.R_hand_tool)).X_camera_ee
        spin_fixed = metrics.paper_rule_angle(fixed[:3, :3], X_true[:3, :3], np.zeros(3))
    return (
        index,
        instance.held_out,
        group.rotation_error(X[:3, :3], X_true[:3, :3]),
        float(np.linalg.norm(X[:3, 3] - X_true[:3, 3])),
        metrics.paper_rule_angle(X[:3, :3], X_true[:3, :3], result.ambiguous),
        metrics.axis_angle(X[:3, :3], X_true[:3, :3], group),
        spin,
        spin_fixed,
        result.confidence,
        usable,
        ms,
    )
