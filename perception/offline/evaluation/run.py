"""Pose evaluation of several estimators on the same clouds, in one process or several, and on frames without a tool."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from toolee_robot.errors import UserError
from toolee_robot.perception import Segmenter
from toolee_robot.perception.offline.dataset.catalogue import Catalogue
from toolee_robot.perception.offline.dataset.spec import generated_catalogue_of
from toolee_robot.perception.offline.evaluation import pose
from toolee_robot.perception.offline.evaluation.estimates import (
    Answer,
    Question,
    answer,
    load_estimator,
    questions,
    summary,
)
from toolee_robot.perception.offline.evaluation.examples import (
    Examples,
    Part,
    joined,
    of_role,
    parts,
    read_part,
)
from toolee_robot.perception.offline.evaluation.pose import held_out_breakdown
from toolee_robot.perception.offline.processes import ProcessMap
from toolee_robot.perception.offline.synthesis.example import expose
from toolee_robot.perception.offline.synthesis.hard import hard_scene
from toolee_robot.perception.offline.synthesis.placement import Pool
from toolee_robot.perception.pipeline import EeDetector, ToolPerception
from toolee_robot.perception.pose.cloud_estimator import CloudEstimator
from toolee_robot.perception.pose.tooleenet import PaperEstimator
from toolee_robot.perception.trust import Trust
from toolee_robot.render.renderer import Shot
from toolee_robot.types import RgbdFrame

T = TypeVar("T")
Progress = Callable[[str, int, int], None]
"""Called with the name of the stage, the finished number and the total."""


@dataclass(frozen=True)
class Plan:
    """What to evaluate.

    Attributes:
        folder: Folder of the data set or split.
        weights: Label to folder of a training; None: the shipped weights. The first label is also used for frames
            without a tool.
        detector: Folder of the detector's weights; None: the shipped ones.
        role: Use of the held-out tools that are asked for, "validation" or "test"; None: all of them.
        true_masks_only: No detector: without predicted masks and frames without a tool.
        limit: Largest number of images per split.
        empty_frames: Number of frames without a tool.
        seed: Seed of the rendered frames.
        device: torch device of the networks.
        workers: Number of processes.
    """

    folder: Path
    weights: dict[str, Path | None]
    detector: Path | None = None
    true_masks_only: bool = False
    role: str | None = None
    limit: int | None = None
    empty_frames: int = 0
    seed: int = 1_000_003
    device: str = "cpu"
    workers: int = 1


@dataclass(frozen=True, eq=False)
class Networks:
    """The networks that each process loads.

    Attributes:
        estimators: By label.
        trust: Trust models by label.
        detector: None where only true masks are evaluated.
    """

    estimators: dict[str, CloudEstimator]
    trust: dict[str, Trust]
    detector: EeDetector | None

    @staticmethod
    def load(plan: Plan) -> Networks:
        """The networks of a plan. Raises AssetError when weights are missing."""
        estimators = {label: load_estimator(folder, plan.device) for label, folder in plan.weights.items()}
        trust = {label: Trust.load(folder, plan.detector) for label, folder in plan.weights.items()}
        return Networks(estimators, trust, None if plan.true_masks_only else Segmenter.load(plan.detector, plan.device))

    @property
    def perception(self) -> ToolPerception:
        """The pipeline of the detector with the first estimator."""
        assert self.detector is not None
        label, estimator = next(iter(self.estimators.items()))
        return ToolPerception(self.detector, estimator, self.trust[label])


def evaluate_pose(plan: Plan, progress: Progress) -> dict[str, Any]:
    """Evaluate. Apart from times, the report is the same for any number of workers.

    Args:
        plan: What to evaluate.
        progress: Called with the name of the stage, the finished number and the total.

    Returns:
        The report, the contents of report.json.

    Raises:
        AssetError: Data or weights are missing.
    """
    networks = Networks.load(plan)
    load = partial(Networks.load, plan) if plan.workers > 1 else lambda: networks
    with ProcessMap(load, plan.workers) as processes:
        todo = parts(plan.folder, plan.limit)
        examples = joined(_counted(processes.map(_read, todo), partial(progress, "reading"), len(todo)))
        if plan.role is not None:
            examples = of_role(examples, plan.role)
        report: dict[str, Any] = {"data": _data(plan.folder, examples), "estimators": {}}
        for label, estimator in networks.estimators.items():
            record: dict[str, Any] = {"method": describe(estimator)}
            for masks in examples.cases:
                asked = questions(examples, masks)
                answers = _counted(
                    processes.map(partial(_answer, label), asked),
                    partial(progress, f"{label}, {masks} masks"),
                    len(asked),
                )
                rows, ranked = summary(examples, answers)
                record[masks] = {
                    "groups": pose.tables(rows),
                    "breakdown": held_out_breakdown(examples.instances, rows),
                    "usable": pose.usable_poses(examples.instances, ranked, examples.images),
                    "latency": {
                        **pose.latency(rows),
                        "device": plan.device,
                        "torch_threads": torch.get_num_threads() if plan.workers == 1 else 1,
                        "workers": plan.workers,
                    },
                }
            report["estimators"][label] = record
        if plan.empty_frames and not plan.true_masks_only:
            frames: Iterable[RgbdFrame | int] = itertools.chain(examples.empty, itertools.count())
            catalogue = generated_catalogue_of(plan.folder)
            looked = processes.map(partial(_claims, plan.seed, catalogue), itertools.islice(frames, plan.empty_frames))
            report["no_tool"] = no_tool(list(_counted(looked, partial(progress, "no tool"), plan.empty_frames)))
    return report


def _read(networks: Networks, part: Part) -> Examples:
    return read_part(part, networks.detector)


def _answer(label: str, networks: Networks, question: Question) -> Answer:
    return answer(networks.estimators[label], networks.trust[label], question)


def _claims(seed: int, catalogue: Catalogue, networks: Networks, frame: RgbdFrame | int) -> tuple[bool, bool]:
    """`empty_frames.claims` of a frame of the data set, or of a rendered one of this number."""
    if isinstance(frame, int):
        frame = empty_frame(seed, frame, catalogue)
    return claims(networks.perception, frame)


def _counted(items: Iterator[T], progress: Callable[[int, int], None], total: int) -> Iterator[T]:
    progress(0, total)
    for k, item in enumerate(items):
        progress(k + 1, total)
        yield item


def describe(estimator: CloudEstimator) -> dict[str, Any]:
    """Name and settings of an estimator."""
    name = f"paper, {estimator.column.name}" if isinstance(estimator, PaperEstimator) else "ours"
    return {"name": name, "candidates": estimator.candidates, "sampler": str(estimator.sampler)}


def _data(folder: Path, examples: Examples) -> dict[str, Any]:
    targets = [i for i in examples.instances if i.target]
    tools = {i.tool for i in targets if i.held_out}
    return {
        "folder": folder.name,
        "images": examples.images,
        "targets": len(targets),
        "left_out_under_50_points": sum(i.too_few_points for i in examples.instances),
        "targets_held_out": sum(i.held_out for i in targets),
        "held_out_tools": len(tools),
        "frames_without_a_tool": len(examples.empty),
    }


def empty_frame(seed: int, index: int, catalogue: Catalogue, split: str = "test") -> RgbdFrame:
    """Render a cluttered frame of the hard scenes without a tool, in many of them an empty hand.

    Args:
        seed: Seed of the scenes.
        index: Number of the frame.
        catalogue: Tools of the other scenes; they are drawn, and so decide what else is.
        split: Split of the textures and backgrounds.

    Returns:
        The frame.
    """
    rng = np.random.default_rng([seed, index, 3])
    sample = hard_scene(rng, Pool.random(rng, split, catalogue), with_tools=False)
    shot = Shot(sample.scene, sample.intrinsics, sample.X_world_camera)
    exposure, automatic = float(rng.uniform(0.75, 1.35)), float(rng.uniform(0.3, 1.0))
    depth, rgb = expose(shot, sample.intrinsics, exposure, automatic, rng)
    return RgbdFrame(rgb, depth, sample.intrinsics)


def claims(perception: ToolPerception, frame: RgbdFrame) -> tuple[bool, bool]:
    """Whether the perception detects something in a frame without a tool, and whether it gives a usable pose."""
    estimates = perception.estimate(frame)
    return bool(estimates), any(e.usable for e in estimates)


def no_tool(each: Sequence[tuple[bool, bool]]) -> dict[str, Any]:
    """How often frames without a tool gave a detection, and how often a usable pose."""
    count, usable = len(each), sum(u for _, u in each)
    quiet = 1 - usable / count if count else None
    detected = sum(d for d, _ in each)
    return {"frames": count, "with_a_detection": detected, "with_a_usable_pose": usable, "share_without": quiet}


def labelled(weights: tuple[str, ...]) -> dict[str, Path | None]:
    """Label -> folder of trainings given as `LABEL=DIR` or `DIR`; the shipped weights, "ours", where none are given.

    Raises:
        UserError: Two have the same label.
    """
    if not weights:
        return {"ours": None}
    labelled: dict[str, Path | None] = {}
    for text in weights:
        label, equals, folder = text.partition("=")
        path = Path(folder if equals else text)
        name = label if equals else path.name
        if name in labelled:
            raise UserError(f"--weights: two trainings are called {name}; give each a label, LABEL=DIR")
        labelled[name] = path
    return labelled
