"""Measure the perception on a data set."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.cli.host_info import describe_machine
from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import text_table
from toolee_robot.cli.progress import progress_bars
from toolee_robot.errors import UserError, words_of
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.json_line import json_line

if TYPE_CHECKING:
    from toolee_robot.perception.offline.evaluation.report import Table

_Dir = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
_Out = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
_Limit = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")]
_Weights = Annotated[tuple[str, ...], tyro.conf.arg(metavar="[LABEL=]DIR", help_behavior_hint="")]
_Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
_Count = Annotated[int, tyro.conf.arg(metavar="N")]
_Device = Annotated[str, tyro.conf.arg(metavar="DEVICE")]


@dataclass(frozen=True)
class EvaluatePose:
    """Measure the poses of a data set.

    The report has the paper's Table I and stricter ones, confidence, usable poses, and frames without a tool.

    Example: toolee evaluate pose data/hard --out report

    Example: toolee evaluate pose data/hard --weights ours=runs/pose paper=runs/paper --no-tool 1000

    Writes report.json and one self-contained report.html. docs/results/protocol.md defines every figure.
    """

    data: _Dir
    """A data set made by `toolee dataset generate`, with a seed not used in training; or one split's folder of it."""
    out: _Out = None
    """Folder for the report (none if left out)."""
    weights: _Weights = ()
    """Folders of trainings, each with a label; the shipped weights, called ours, if left out. The first one is also the
    one that looks at frames without a tool."""
    detector: _Folder = None
    """Folder with the detector's weights (the shipped ones if left out)."""
    true_masks_only: Flag = False
    """No detector: leave out predicted masks and frames without a tool."""
    tools: Literal["all", "validation", "test"] = "all"
    """Which of the held-out tools: half are for validation, by which choices are made, half for tests."""
    limit: _Limit = None
    """Only so many images of each split."""
    no_tool: _Count = 0
    """Cluttered frames without a tool; those that the data set lacks are rendered."""
    device: _Device = "cpu"
    """Where the networks run: cpu or cuda."""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 1
    """Processes, each with networks of its own and one core. The figures are the same for any number, but for the
    latencies: measure those with one."""
    json: Flag = False
    """Print the whole report as one line of JSON; everything for people goes to standard error."""

    def run(self) -> int:
        from toolee_robot.perception.offline.evaluation import report
        from toolee_robot.perception.offline.evaluation.ledger import Ledger, pose_figures
        from toolee_robot.perception.offline.evaluation.run import Plan, evaluate_pose, labelled

        console = Console(stderr=self.json, highlight=False)
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
        with progress_bars(console) as progress:
            found = evaluate_pose(plan, progress)
        if ledger is not None:
            weights = plan.weights if self.true_masks_only else {**plan.weights, "detector": self.detector}
            ledger.enter("pose", weights, pose_figures(found.report), self.limit)
        about = report.described(found.report["data"])
        pictures = {} if self.out is None else report.accuracy_pictures(found.estimates)
        ending = _Ending(console, self.out, self.json, "6D pose of tool end effectors", about)
        return ending.run(found.report, report.pose_tables(found.report), pictures)


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
    device: _Device = "cpu"
    """Where the network runs: cpu or cuda."""
    json: Flag = False
    """Print one line of JSON; everything for people goes to standard error."""

    def run(self) -> int:
        from toolee_robot.perception.offline.evaluation import report, segmentation
        from toolee_robot.perception.offline.evaluation.ledger import Ledger

        console = Console(stderr=self.json, highlight=False)
        ledger = Ledger.of(self.data)
        with console.status("the detector looks at every image"):
            found = segmentation.evaluate(self.data, self.weights, self.limit, self.device)
        if ledger is not None:
            ledger.enter("segmentation", {"detector": self.weights}, {"average": found["average"]}, self.limit)
        ending = _Ending(console, self.out, self.json, "segmentation", segmentation.ABOUT)
        return ending.run({"data": self.data.name, **found}, report.segmentation_tables(found))


@dataclass(frozen=True)
class EvaluatePhotographs:
    """Measure detector and estimator on real RGB-D frames.

    The report has the ends found, the poses that are right, and the false alarms.

    Example: toolee evaluate photographs data/photographs

    docs/dataset.md says what such a folder holds and where the development set comes from.
    """

    data: _Dir
    """A folder with frames.json."""
    weights: _Folder = None
    """Folder of weights (the shipped ones if left out)."""
    limit: _Limit = None
    """Only so many frames of each place."""
    device: _Device = "cpu"
    """Where the networks run: cpu or cuda."""
    out: _Out = None
    """Folder for the report (none if left out)."""
    json: Flag = False
    """Print one line of JSON; everything for people goes to standard error."""

    def run(self) -> int:
        from toolee_robot.perception.offline.evaluation import report
        from toolee_robot.perception.offline.evaluation.ledger import Ledger
        from toolee_robot.perception.offline.evaluation.photographs import evaluate, read_photographs
        from toolee_robot.perception.pipeline import ToolPerception

        console = Console(stderr=self.json, highlight=False)
        photographs = read_photographs(self.data, self.limit)
        ledger = Ledger.of(self.data)
        perception = ToolPerception.load(self.weights, self.device)
        with progress_bars(console) as progress:
            found = evaluate(perception, photographs, lambda k, n: progress("photographs", k, n))
        if ledger is not None:
            ledger.enter("photographs", {"ours": self.weights}, {"table": found["table"]}, self.limit)
        ending = _Ending(console, self.out, self.json, "photographs", "")
        return ending.run({"data": self.data.name, **found}, report.photograph_tables(found))


COMMANDS = {
    "pose": EvaluatePose,
    "segmentation": EvaluateSegmentation,
    "photographs": EvaluatePhotographs,
}


@dataclass(frozen=True)
class _Ending:
    """What every evaluation ends with: report.json and report.html, the tables, the line of JSON.

    Attributes:
        console: Where the tables go.
        out: Folder of the report; None: none.
        json: Whether to print the record.
        title: Title of the page.
        about: Its first paragraph.
    """

    console: Console
    out: Path | None
    json: bool
    title: str
    about: str

    def run(self, record: dict[str, Any], tables: Sequence[Table], pictures: dict[str, bytes] | None = None) -> int:
        from toolee_robot.perception.offline.evaluation.report import page

        machine = describe_machine()
        record = {"machine": asdict(machine), **record}
        if self.out is not None:
            now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
            command = "toolee " + shlex.join(sys.argv[1:])
            subtitle = f"{now} · {machine.cpu}, {machine.cores} cores · {command}"
            try:
                self.out.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise UserError(
                    f"cannot make the folder {self.out}: {words_of(error)}; choose another place",
                    code="user.folder_not_writable",
                ) from error
            write_atomic(self.out / "report.json", json_line(record).encode() + b"\n")
            html = page(self.title, subtitle, self.about, tables, pictures or {})
            write_atomic(self.out / "report.html", html.encode())
            self.console.print(f"report: {escape(str(self.out / 'report.html'))}", soft_wrap=True)
        for table in tables:
            if not table.on_page_only:
                self.console.print(text_table(table.title, table.columns, table.rows, table.left))
        if self.json:
            print(json_line(record))
        return 0
