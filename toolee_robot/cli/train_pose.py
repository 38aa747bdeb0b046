"""`toolee train clouds` and `toolee train pose`: the pose network and what it learns from."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.cli.progress import progress_bars
from toolee_robot.cli.train_options import Count, File, Folder, Number, OutDir, make_folder, options_of, remember
from toolee_robot.errors import UserError

if TYPE_CHECKING:
    from toolee_robot.perception.pose.train_config import TrainConfig

Estimator = Literal["ours", "paper"]
ColumnName = Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")]


@dataclass(frozen=True)
class Clouds:
    """Keep the clouds of a data set's images, under true masks and the detector's, for the pose network's training.

    Example: toolee train clouds data/hard/train --out runs/clouds.npz --workers 2

    Take images that the detector was not trained on. The paper's estimator learns from true masks alone: say
    --estimator paper, and the --column of its training.
    """

    data: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """A data set, or one split of it."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """Where the clouds go, for `toolee train pose --rendered FILE`."""
    estimator: Estimator = "ours"
    """Whose training they are for; paper: ToolEENet's own."""
    column: ColumnName = None
    """Of the paper's Table I, for --estimator paper (default: symmetry-aware)."""
    weights: Folder = None
    """The detector's weights (default: those that ship)."""
    limit: Count = None
    """Images of each split (default: all)."""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 1
    """Processes at a time."""
    device: Annotated[str, tyro.conf.arg(metavar="NAME")] = "cpu"
    """Where the detector runs: cpu, cuda, cuda:1."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        console = Console(stderr=self.json, highlight=False)
        from toolee_robot.perception.pose.paper import column_of
        from toolee_robot.perception.rendered_clouds import rendered_clouds

        column = column_of(self.estimator, self.column)
        if column is not None and self.weights is not None:
            raise UserError("--weights: for --estimator paper the true masks are taken, no detector's")
        # Before the work: it may take hours.
        make_folder(self.out.parent)
        with progress_bars(console) as report:
            clouds = rendered_clouds(
                self.data,
                self.weights,
                self.device,
                self.workers,
                self.limit,
                partial(report, "scene folders"),
                column,
            )
        clouds.save(self.out)
        shown = int(clouds.positive.sum())
        kind = "whole tools" if clouds.of_tool.any() else "end effectors"
        negatives = f" and {len(clouds) - shown} of what is none" if column is None else ""
        console.print(f"{shown} clouds of {kind}{negatives} in {self.out}")
        if self.json:
            print(json_line({"out": str(self.out), "positive": shown, "negative": len(clouds) - shown}), flush=True)
        return 0


@dataclass(frozen=True)
class Pose:
    """Train the pose network on clouds that are made as they are needed.

    Example: toolee train pose --out runs/pose --minutes 20

    The same command again continues from the last checkpoint in DIR. Several GPUs: torchrun --nproc-per-node 4 -m
    toolee_robot.perception.train_pose, with the same options.
    """

    out: OutDir
    """Checkpoint, weights with configuration and calibration, log, TensorBoard curves (extra `train`)."""
    config: File = None
    """YAML or JSON of options, any subset of those of toolee_robot.perception.train_pose; the command line's win."""
    estimator: Estimator = "ours"
    """paper: ToolEENet's own."""
    column: ColumnName = None
    """Of the paper's Table I, for --estimator paper (default: symmetry-aware)."""
    protocol: Literal["hard", "paper"] = "hard"
    """Which data set's views the clouds are like."""
    minutes: Number = None
    """Wall-clock of the optimisation (default: 9)."""
    max_steps: Count = None
    """Budget in steps instead of minutes."""
    batch: Count = None
    """Clouds a step (default: 512)."""
    learning_rate: Number = None
    """(default: 0.001)"""
    seed: Count = None
    """Of weights, clouds and order (default: 0)."""
    checkpoint_seconds: Number = None
    """Between checkpoints (default: 120)."""
    hands: File = None
    """Hand samples, for machines without the hand's model."""
    rendered: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = ()
    """Clouds of rendered images to mix in, made by `toolee train clouds`."""
    rendered_share: Number = None
    """Of the clouds, where rendered ones are given (default: 0.5)."""
    json: Flag = False
    """Print one line of JSON last on standard output."""

    def run(self) -> int:
        from toolee_robot.perception.pose.cloud_batch import PROTOCOLS
        from toolee_robot.perception.pose.method import Ours
        from toolee_robot.perception.pose.paper import PaperMethod, column_of
        from toolee_robot.perception.pose.train_config import TrainConfig
        from toolee_robot.perception.pose.training import train

        column = column_of(self.estimator, self.column)
        options = options_of(self, self.config, {f.name for f in fields(TrainConfig) if f.default is not MISSING})
        config: TrainConfig = TrainConfig(**options)
        resume = (self.out / "checkpoint.pt").is_file()
        about = {f.name: getattr(config, f.name) for f in fields(TrainConfig)}
        about |= {"estimator": self.estimator, "column": column.name if column else None, "protocol": self.protocol}
        remember(self.out, resume, {**about, "rendered": [str(path) for path in self.rendered]})
        clouds = PROTOCOLS[self.protocol]()
        method: Any = Ours(clouds_config=clouds) if column is None else PaperMethod(column, clouds)
        report = train(self.out, config, method, self.hands, rendered=self.rendered)
        if self.json:
            print(json_line({"out": str(self.out), "resumed": resume, "report": report}), flush=True)
        return 0
