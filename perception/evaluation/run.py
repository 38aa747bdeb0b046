"""The whole evaluation of the pose: several estimators on the same clouds, in one run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any

import torch

from toolee_robot.perception.evaluation import pose, views
from toolee_robot.perception.evaluation.estimates import Estimates, estimate_all, load_estimator
from toolee_robot.perception.evaluation.examples import Examples, collect
from toolee_robot.perception.evaluation.samplers import sampler_table
from toolee_robot.perception.pipeline import EeDetector, ToolPerception
from toolee_robot.perception.pose.cloud_estimator import CloudEstimator
from toolee_robot.perception.pose.paper import PaperEstimator
from toolee_robot.types import RgbdFrame

Progress = Callable[[str, int, int], None]
"""What is being done, how much of it is done, how much there is."""


@dataclass(frozen=True)
class Plan:
    """What to evaluate. weights: label -> folder of a training (None: the shipped weights). limit: images of a split.
    hammers: how many are looked at from five views; empty_frames: how many frames without a tool are looked at;
    sampler_clouds: clouds for the table of samplers. The first label is the one that these three are done with."""

    folder: Path
    weights: dict[str, Path | None]
    limit: int | None = None
    hammers: int = 0
    empty_frames: int = 0
    sampler_clouds: int = 0
    seed: int = 1_000_003


@dataclass(frozen=True, eq=False)
class Evaluation:
    """report: everything, as it is written to report.json. estimates: label -> kind of masks -> rows, for pictures."""

    report: dict[str, Any]
    estimates: dict[str, dict[str, Estimates]]


def evaluate_pose(plan: Plan, detector: EeDetector | None, device: str, progress: Progress) -> Evaluation:
    """detector: for predicted masks, fused views and frames without a tool; without one these are left out.

    Raises AssetError when data or weights are missing.
    """
    estimators = {label: load_estimator(folder, device) for label, folder in plan.weights.items()}
    progress("reading", 0, 1)
    examples = collect(plan.folder, detector, plan.limit)
    progress("reading", 1, 1)
    report: dict[str, Any] = {"data": _data(plan.folder, examples), "estimators": {}}
    estimates: dict[str, dict[str, Estimates]] = {}
    for label, estimator in estimators.items():
        estimates[label] = {}
        record: dict[str, Any] = {"method": describe(estimator)}
        for masks in examples.cases:
            report_case = partial(progress, f"{label}, {masks} masks")
            rows, ranked = estimate_all(estimator, examples, masks, report_case)
            estimates[label][masks] = rows
            record[masks] = {
                "groups": pose.tables(rows),
                "ranked_ap": pose.ranked_ap(examples, ranked),
                "latency": {**pose.latency(rows), "device": device, "torch_threads": torch.get_num_threads()},
            }
        report["estimators"][label] = record
    first = next(iter(estimators.values()))
    if plan.sampler_clouds:
        report["samplers"] = sampler_table(first, examples, plan.sampler_clouds, partial(progress, "samplers"))
    if detector is not None:
        perception = ToolPerception(detector, first)
        if plan.hammers:
            hammers = views.held_hammers(plan.hammers, plan.seed)
            report["fused"] = views.fused(perception, hammers, plan.hammers, partial(progress, "five views"))
        if plan.empty_frames:
            frames: islice[RgbdFrame] = islice(
                chain(examples.empty, views.empty_frames(plan.empty_frames, plan.seed)), plan.empty_frames
            )
            report["no_tool"] = views.no_tool(perception, frames, plan.empty_frames, partial(progress, "no tool"))
    return Evaluation(report, estimates)


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
