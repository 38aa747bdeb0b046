"""Measure the perception on a data set."""

from __future__ import annotations

import shlex
import sys
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.cli.evaluate_held import EvaluateHeld
from toolee_robot.cli.evaluate_tables import (
    photograph_tables,
    pose_tables,
    printed_samplers,
    segmentation_rows,
    text_table,
)
from toolee_robot.cli.host_info import describe_machine
from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.cli.progress import progress_bars
from toolee_robot.errors import UserError, words_of
from toolee_robot.runtime.files import write_atomic

if TYPE_CHECKING:
    from toolee_robot.perception.offline.evaluation.run import Evaluation, Plan

_Dir = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
_Out = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
_Limit = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")]
_Weights = Annotated[tuple[str, ...], tyro.conf.arg(metavar="[LABEL=]DIR", help_behavior_hint="")]
_Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
_Count = Annotated[int, tyro.conf.arg(metavar="N")]


@dataclass(frozen=True)
class EvaluatePose:
    """The paper's Table I and stricter ones, confidence, samplers, fused views, frames without a tool.

    Example: toolee evaluate pose data/hard --out report

    Example: toolee evaluate pose data/hard --weights ours=runs/pose paper=runs/paper --hammers 200 --no-tool 1000

    Writes report.json, pictures and one self-contained report.html. docs/results/protocol.md defines every figure.
    """

    data: _Dir
    """A data set made by `toolee dataset generate`, with a seed not used in training; or one split's folder of it."""
    out: _Out = None
    """Folder for the report (none if left out)."""
    weights: _Weights = ()
    """Folders of trainings, each with a label; the shipped weights, called ours, if left out. The first one is also the
    one whose samplers, fused views and frames without a tool are evaluated."""
    detector: _Folder = None
    """Folder with the detector's weights (the shipped ones if left out)."""
    true_masks_only: Flag = False
    """No detector: leave out predicted masks, fused views and frames without a tool."""
    tools: Literal["all", "validation", "test"] = "all"
    """Which of the held-out tools: half are for validation, by which choices are made, half for tests."""
    limit: _Limit = None
    """Only so many images of each split."""
    samplers: _Count = 0
    """Clouds for the table of samplers; 0 leaves it out."""
    hammers: _Count = 0
    """Held hammers to look at from five views; they are rendered, about 2 s each."""
    no_tool: _Count = 0
    """Cluttered frames without a tool; those that the data set lacks are rendered."""
    exact_shape: Flag = False
    """Also fit each tool's exact shape to its cloud, from the true pose: what the depth images allow."""
    device: Annotated[str, tyro.conf.arg(metavar="DEVICE")] = "cpu"
    """Where the networks run: cpu or cuda."""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 1
    """Processes, each with networks of its own and one core. The figures are the same for any number, but for the
    latencies: measure those with one."""
    json: Flag = False
    """Print the whole report as one line of JSON; everything for people goes to standard error."""

    def run(self) -> int:
        from toolee_robot.perception.offline.evaluation.ledger import Ledger, pose_figures
        from toolee_robot.perception.offline.evaluation.run import Plan

        console = Console(stderr=self.json, highlight=False)
        plan = Plan(
            self.data,
            _labelled(self.weights),
            self.detector,
            self.true_masks_only,
            None if self.tools == "all" else self.tools,
            self.limit,
            self.hammers,
            self.no_tool,
            self.samplers,
            device=self.device,
            workers=self.workers,
            exact_shape=self.exact_shape,
        )
        ledger = Ledger.of(self.data)
        evaluation = _evaluated(console, plan)
        if ledger is not None:
            weights = plan.weights if self.true_masks_only else {**plan.weights, "detector": self.detector}
            ledger.enter("pose", weights, pose_figures(evaluation.report), self.limit)
        if self.out is not None:
            from toolee_robot.perception.offline.evaluation.report.pages import page, pictures

            images = pictures(evaluation)
            _write(console, self.out, evaluation.report, images, page(evaluation, images, _subtitle()))
        for table in pose_tables(evaluation.report):
            console.print(table)
        if self.json:
            print(json_line(evaluation.report))
        return 0


@dataclass(frozen=True)
class EvaluateSamplers:
    """Accuracy of the pose against network evaluations and time: RK45, the paper's, beside few fixed steps.

    Example: toolee evaluate samplers data/hard --weights runs/pose --clouds 500
    """

    data: _Dir
    """A data set made by `toolee dataset generate`, or one split's folder of it."""
    out: _Out = None
    """Folder for the report (none if left out)."""
    weights: _Folder = None
    """Folder of a training (the shipped weights if left out)."""
    clouds: _Count = 500
    """So many clouds under true masks, held-out tools first."""
    device: Annotated[str, tyro.conf.arg(metavar="DEVICE")] = "cpu"
    """Where the network runs: cpu or cuda."""
    json: Flag = False
    """Print one line of JSON; everything for people goes to standard error."""

    def run(self) -> int:
        from toolee_robot.perception.offline.evaluation.estimates import load_estimator
        from toolee_robot.perception.offline.evaluation.examples import collect
        from toolee_robot.perception.offline.evaluation.ledger import Ledger
        from toolee_robot.perception.offline.evaluation.samplers import sampler_table

        if self.clouds < 1:
            raise UserError(f"--clouds {self.clouds}: give 1 or more", code="user.count")
        console = Console(stderr=self.json, highlight=False)
        ledger = Ledger.of(self.data)
        estimator = load_estimator(self.weights, self.device)
        with progress_bars(console) as report:
            examples = collect(self.data, limit=self.clouds)
            rows = sampler_table(estimator, examples, self.clouds, lambda k, n: report("samplers", k, n))
        if ledger is not None:
            ledger.enter("samplers", {"ours": self.weights}, {r["sampler"]: r["average"] for r in rows}, self.clouds)
        record = {"machine": asdict(describe_machine()), "samplers": rows}
        if self.out is not None:
            from toolee_robot.perception.offline.evaluation.report.figures import sampler_figure
            from toolee_robot.perception.offline.evaluation.report.pages import sampler_page

            images = {"samplers.png": sampler_figure(rows, "Samplers, one cloud at a time: RK45, and numbers of steps")}
            _write(console, self.out, record, images, sampler_page(rows, images, _subtitle()))
        console.print(printed_samplers(rows))
        if self.json:
            print(json_line(record))
        return 0


@dataclass(frozen=True)
class EvaluateSegmentation:
    """COCO mask AP of the detector, per category.

    Example: toolee evaluate segmentation data/hard/test --out report
    """

    data: _Dir
    """One split's folder of a data set made by `toolee dataset generate`."""
    out: _Out = None
    """Folder for the report (none if left out)."""
    weights: _Folder = None
    """Folder of a training (the shipped weights if left out)."""
    limit: _Limit = None
    """Only so many images."""
    device: Annotated[str, tyro.conf.arg(metavar="DEVICE")] = "cpu"
    """Where the network runs: cpu or cuda."""
    json: Flag = False
    """Print one line of JSON; everything for people goes to standard error."""

    def run(self) -> int:
        from toolee_robot.perception.offline.evaluation.ledger import Ledger
        from toolee_robot.perception.offline.evaluation.segmentation import STATISTICS, evaluate

        console = Console(stderr=self.json, highlight=False)
        ledger = Ledger.of(self.data)
        with console.status("the detector looks at every image"):
            found = evaluate(self.data, self.weights, self.limit, self.device)
        if ledger is not None:
            ledger.enter("segmentation", {"detector": self.weights}, {"average": found["average"]}, self.limit)
        rows = segmentation_rows(found)
        record = {"machine": asdict(describe_machine()), "data": self.data.name, **found}
        if self.out is not None:
            from toolee_robot.perception.offline.evaluation.report.pages import segmentation_page

            _write(console, self.out, record, {}, segmentation_page(found, rows, STATISTICS, _subtitle()))
        console.print(text_table("Segmentation, COCO mask AP [%]", ("class", "n", *STATISTICS), rows))
        if self.json:
            print(json_line(record))
        return 0


@dataclass(frozen=True)
class EvaluatePhotographs:
    """Detector and estimator on real RGB-D frames: ends found, poses right, false alarms.

    Example: toolee evaluate photographs data/photographs

    docs/dataset.md says what such a folder holds and where the development set comes from.
    """

    data: _Dir
    """A folder with frames.json."""
    weights: _Folder = None
    """Folder of weights (the shipped ones if left out)."""
    limit: _Limit = None
    """Only so many frames of each place."""
    device: Annotated[str, tyro.conf.arg(metavar="DEVICE")] = "cpu"
    """Where the networks run: cpu or cuda."""
    out: _Out = None
    """Folder for report.json (none if left out)."""
    json: Flag = False
    """Print one line of JSON; everything for people goes to standard error."""

    def run(self) -> int:
        from toolee_robot.perception.offline.evaluation.ledger import Ledger
        from toolee_robot.perception.offline.evaluation.photograph_scores import evaluate
        from toolee_robot.perception.offline.evaluation.photographs import read_photographs
        from toolee_robot.perception.pipeline import ToolPerception

        console = Console(stderr=self.json, highlight=False)
        photographs = read_photographs(self.data, self.limit)
        ledger = Ledger.of(self.data)
        perception = ToolPerception.load(self.weights, self.device)
        with progress_bars(console) as report:
            found = evaluate(perception, photographs, lambda k, n: report("photographs", k, n))
        if ledger is not None:
            ledger.enter("photographs", {"ours": self.weights}, {"table": found["table"]}, self.limit)
        record = {"machine": asdict(describe_machine()), "data": self.data.name, **found}
        if self.out is not None:
            _make_folder(self.out)
            write_atomic(self.out / "report.json", json_line(record).encode() + b"\n")
        for table in photograph_tables(found):
            console.print(table)
        if self.json:
            print(json_line(record))
        return 0


COMMANDS = {
    "pose": EvaluatePose,
    "segmentation": EvaluateSegmentation,
    "samplers": EvaluateSamplers,
    "held": EvaluateHeld,
    "photographs": EvaluatePhotographs,
}


def _evaluated(console: Console, plan: Plan) -> Evaluation:
    from toolee_robot.perception.offline.evaluation.run import evaluate_pose

    with progress_bars(console) as report:
        evaluation = evaluate_pose(plan, report)
    evaluation.report["machine"] = asdict(describe_machine())
    return evaluation


def _labelled(weights: tuple[str, ...]) -> dict[str, Path | None]:
    if not weights:
        return {"ours": None}
    labelled: dict[str, Path | None] = {}
    for text in weights:
        label, equals, folder = text.partition("=")
        path = Path(folder if equals else text)
        name = label if equals else path.name
        if name in labelled:
            raise UserError(
                f"--weights: two trainings are called {name}; give each a label, LABEL=DIR", code="user.duplicate_label"
            )
        labelled[name] = path
    return labelled


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(
            f"cannot make the folder {out}: {words_of(error)}; choose another place",
            code="user.folder_not_writable",
        ) from error


def _write(console: Console, out: Path, report: dict[str, Any], images: dict[str, bytes], html: str) -> None:
    _make_folder(out)
    write_atomic(out / "report.json", json_line(report).encode() + b"\n")
    for name, data in images.items():
        write_atomic(out / name, data)
    write_atomic(out / "report.html", html.encode())
    console.print(f"report: {escape(str(out / 'report.html'))}", soft_wrap=True)


def _subtitle() -> str:
    machine = describe_machine()
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    command = "toolee " + shlex.join(sys.argv[1:])
    return f"{now} · {machine.cpu}, {machine.cores} cores · {command}"
