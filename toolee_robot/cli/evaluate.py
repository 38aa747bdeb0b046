"""Measure the perception on a data set."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.markup import escape

from toolee_robot.cli.output import Flag, JsonOption, progress_bars, text_table
from toolee_robot.runtime.files import json_line, write_atomic

if TYPE_CHECKING:
    from toolee_robot.perception.offline.evaluation.report import Table

_Dir = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
_Weights = Annotated[tuple[str, ...], tyro.conf.arg(metavar="[LABEL=]DIR", help_behavior_hint="")]
_Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]


@dataclass(frozen=True, kw_only=True)
class _Evaluation(JsonOption):
    """Options of every evaluation, and what it ends with: report.json, the tables, the line of JSON."""

    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder for the report (none if left out)."""
    limit: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None
    """At most this many images per split or place."""
    device: Annotated[str, tyro.conf.arg(metavar="DEVICE")] = "cpu"
    """Where the networks run: cpu or cuda."""

    def end(self, record: dict[str, Any], tables: Sequence[Table]) -> int:
        """Write the report if it was asked for, and print the tables."""
        record = {"machine": describe_machine(), **record}
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
            path = self.out / "report.json"
            write_atomic(path, json_line(record).encode() + b"\n")
            self.console.print(f"report: {escape(str(path))}", soft_wrap=True)
        for table in tables:
            self.console.print(text_table(table.title, table.columns, table.rows, table.left))
        self.tell(record)
        return 0


@dataclass(frozen=True)
class EvaluatePose(_Evaluation):
    """Measure the poses of a data set.

    The report has the paper's Table I, stricter limits, confidence, usable poses, and frames without a tool.

    Example: toolee evaluate pose data/hard --out report

    Example: toolee evaluate pose data/hard --weights ours=runs/pose paper=runs/paper --no-tool 1000

    Writes report.json. docs/results/protocol.md defines every figure.
    """

    data: _Dir
    """A data set made by `toolee dataset generate`, with a seed not used in training; or one split's folder of it."""
    weights: _Weights = ()
    """Folders of trainings, each with a label (default: the shipped weights, as ours). The first one also gets the
    frames without a tool.
    """
    detector: _Folder = None
    """Folder with the detector's weights (the shipped ones if left out)."""
    true_masks_only: Flag = False
    """No detector: leave out predicted masks and frames without a tool."""
    tools: Literal["all", "validation", "test"] = "all"
    """Which of the test split's tools: one half is for validation, the other for tests."""
    no_tool: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Number of cluttered frames without a tool. Missing ones are rendered."""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 1
    """Number of processes, each with one core. Only latencies depend on it: measure those with one."""

    def run(self) -> int:
        from toolee_robot.perception.offline.evaluation import report
        from toolee_robot.perception.offline.evaluation.ledger import Ledger, pose_figures
        from toolee_robot.perception.offline.evaluation.run import Plan, evaluate_pose, labelled

        role = None if self.tools == "all" else self.tools
        plan = Plan(
            self.data,
            labelled(self.weights),
            self.detector,
            self.true_masks_only,
            role,
            self.limit,
            self.no_tool,
            device=self.device,
            workers=self.workers,
        )
        ledger = Ledger.of(self.data)
        with progress_bars(self.console) as progress:
            found = evaluate_pose(plan, progress)
        if ledger is not None:
            weights = plan.weights if self.true_masks_only else {**plan.weights, "detector": self.detector}
            ledger.enter("pose", weights, pose_figures(found), self.limit)
        return self.end(found, report.pose_tables(found))


@dataclass(frozen=True)
class EvaluateSegmentation(_Evaluation):
    """COCO mask AP of the detector, per category.

    Example: toolee evaluate segmentation data/hard/test --out report
    """

    data: _Dir
    """One split's folder of a data set made by `toolee dataset generate`."""
    weights: _Folder = None
    """Folder of a training (the shipped weights if left out)."""

    def run(self) -> int:
        from toolee_robot.perception.offline.evaluation import report, segmentation
        from toolee_robot.perception.offline.evaluation.ledger import Ledger

        ledger = Ledger.of(self.data)
        with self.console.status("the detector processes every image"):
            found = segmentation.evaluate(self.data, self.weights, self.limit, self.device)
        if ledger is not None:
            ledger.enter("segmentation", {"detector": self.weights}, {"average": found["average"]}, self.limit)
        record = {"data": self.data.name, **found}
        return self.end(record, report.segmentation_tables(found))


@dataclass(frozen=True)
class EvaluatePhotographs(_Evaluation):
    """Measure detector and estimator on real RGB-D frames.

    The report has the share of end effectors found, of right poses, and the false alarms.

    Example: toolee evaluate photographs data/photographs

    docs/dataset.md says what such a folder holds and where the development set comes from.
    """

    data: _Dir
    """A folder with frames.json."""
    weights: _Folder = None
    """Folder of weights (the shipped ones if left out)."""

    def run(self) -> int:
        from toolee_robot.perception.offline.evaluation import report
        from toolee_robot.perception.offline.evaluation.ledger import Ledger
        from toolee_robot.perception.offline.evaluation.photographs import evaluate, read_photographs
        from toolee_robot.perception.pipeline import ToolPerception

        photographs = read_photographs(self.data, self.limit)
        ledger = Ledger.of(self.data)
        perception = ToolPerception.load(self.weights, self.device)
        with progress_bars(self.console) as progress:
            found = evaluate(perception, photographs, lambda k, n: progress("photographs", k, n))
        if ledger is not None:
            ledger.enter("photographs", {"ours": self.weights}, {"table": found["table"]}, self.limit)
        record = {"data": self.data.name, **found}
        return self.end(record, report.photograph_tables(found))


@dataclass(frozen=True)
class EvaluateTable1(_Evaluation):
    """Repeat a column of the paper's Table I on new images.

    It shows 36 held-out tools and the 42 seen ones. Poses under true masks are judged by the paper's rule.

    Example: toolee evaluate table1 --workers 2
    """

    weights: _Folder = None
    """Folder of a `toolee train paper` or `toolee train pose` training (default: the shipped weights of the former)."""
    images: Annotated[int, tyro.conf.arg(metavar="N")] = 4
    """Images of each tool."""
    seed: int = 880793
    """Seed of the images. Take none that a training used."""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 1
    """Processes that render."""

    def run(self) -> int:
        from toolee_robot.perception.offline.evaluation import report
        from toolee_robot.perception.offline.evaluation.estimates import load_estimator
        from toolee_robot.perception.offline.published import table
        from toolee_robot.perception.pose.tooleenet.estimator import SHIPPED, PaperEstimator

        estimator = load_estimator(self.weights or SHIPPED, self.device, whole_tools=True)
        column = estimator.column.name if isinstance(estimator, PaperEstimator) else "ours"
        with progress_bars(self.console) as progress:
            groups = table(estimator, min(self.images, self.limit or self.images), self.seed, self.workers, progress)
        return self.end({"column": column, "groups": groups}, report.table1(groups, column))


COMMANDS = {
    "evaluate": {
        "pose": EvaluatePose,
        "segmentation": EvaluateSegmentation,
        "photographs": EvaluatePhotographs,
        "table1": EvaluateTable1,
    }
}


_PACKAGES = ("toolee_robot", "numpy", "scipy", "torch", "torchvision", "pin", "coal", "ruckig", "pybullet", "embreex")


def describe_machine() -> dict[str, Any]:
    """Read the description from the operating system; "unknown" where it is not available."""
    import torch

    from toolee_robot.perception.precision import prefers_bfloat16

    cpu = platform.processor() or platform.machine() or "unknown"
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [
            line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if line.startswith("model name")
        ]
        cpu = names[0] if names else cpu
    versions = {}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "cpu": cpu,
        "cores": len(os.sched_getaffinity(0)),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": platform.python_version(),
        "torch_threads": torch.get_num_threads(),
        "arithmetic": "bfloat16" if prefers_bfloat16(torch.device("cpu")) else "float32",
        "versions": versions,
    }
