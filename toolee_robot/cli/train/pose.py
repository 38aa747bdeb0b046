"""`toolee train clouds` and `toolee train pose`: training data and training of the pose network."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.cli.progress import progress_bars
from toolee_robot.cli.train.options import (
    CHECKPOINT,
    Count,
    Folder,
    Number,
    TrainingCommand,
    make_folder,
    options_of,
    remember,
)
from toolee_robot.errors import UserError
from toolee_robot.runtime.json_line import json_line

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
    """Estimator that they train; paper: ToolEENet."""
    column: ColumnName = None
    """Of the paper's Table I, for --estimator paper (default: symmetry-aware)."""
    weights: Folder = None
    """The detector's weights (default: those that ship)."""
    limit: Count = None
    """Images of each split (default: all)."""
    minutes: Number = None
    """Keep the clouds that are made within this time (default: until all are made)."""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 1
    """Processes at a time."""
    device: Annotated[str, tyro.conf.arg(metavar="NAME")] = "cpu"
    """Where the detector runs: cpu, cuda:1, or cuda: spread over all GPUs."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        console = Console(stderr=self.json, highlight=False)
        from toolee_robot.perception.offline.rendered_clouds import rendered_clouds
        from toolee_robot.perception.offline.research.tooleenet import column_of

        column = column_of(self.estimator, self.column)
        if column is not None and self.weights is not None:
            raise UserError(
                "--weights: for --estimator paper the true masks are taken, no detector's", code="user.option"
            )
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
                self.minutes,
            )
        clouds.save(self.out)
        shown = int(clouds.positive.sum())
        kind = "whole tools" if clouds.of_tool.any() else "end effectors"
        negatives = f" and {len(clouds) - shown} of other things" if column is None else ""
        console.print(f"{shown} clouds of {kind}{negatives} in {self.out}")
        if self.json:
            print(json_line({"out": str(self.out), "positive": shown, "negative": len(clouds) - shown}), flush=True)
        return 0


@dataclass(frozen=True)
class Pose(TrainingCommand):
    """Train the pose network on clouds that are made as they are needed.

    Example: toolee train pose --out runs/pose --minutes 20

    The same command again continues from the last checkpoint in DIR. Several GPUs: torchrun --no-python
    --nproc-per-node 4 toolee train pose, with the same options.
    """

    minutes: Number = None
    """Wall-clock of the optimisation (default: 9)."""
    batch: Count = None
    """Clouds a step, of each GPU (default: 512)."""
    estimator: Estimator = "ours"
    """paper: ToolEENet's own."""
    column: ColumnName = None
    """Of the paper's Table I, for --estimator paper (default: symmetry-aware)."""
    protocol: Literal["hard", "paper"] = "hard"
    """Which data set's views the clouds are like."""
    rendered: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = ()
    """Clouds of rendered images to mix in, made by `toolee train clouds`."""
    rendered_share: Number = None
    """Of the clouds, where rendered ones are given (default: 0.5)."""
    init_share: Number = None
    """Of the weights of --init in those that are exported (default: 0)."""
    train_seeds: Count = None
    """Tools of each kind to learn from (default: 480)."""
    test_seeds: Count = None
    """Held-out tools of each kind (default: 30)."""
    validation: Count = None
    """Held-out clouds (default: 4096)."""
    freeze_batchnorm: Number = None
    """Share of the budget after which batch normalisation keeps its statistics (default: 0.25)."""
    calibrate_only: Flag = False
    """Validate and calibrate the weights that lie in --out, without training."""

    def run(self) -> int:
        from toolee_robot.perception.offline.pose.config import TrainConfig
        from toolee_robot.perception.offline.pose.recipe import DefaultRecipe
        from toolee_robot.perception.offline.pose.trainer import train
        from toolee_robot.perception.offline.research.tooleenet import PaperRecipe, column_of
        from toolee_robot.perception.offline.synthetic_clouds.batch import PROTOCOLS

        column = column_of(self.estimator, self.column)
        config: TrainConfig = TrainConfig(**options_of(self, self.config, {f.name for f in fields(TrainConfig)}))
        resumed = (self.out / CHECKPOINT).is_file()
        about = {f.name: getattr(config, f.name) for f in fields(TrainConfig)}
        about |= {"estimator": self.estimator, "column": column.name if column else None, "protocol": self.protocol}
        if not self.calibrate_only:
            remember(self.out, resumed, {**about, "rendered": [str(path) for path in self.rendered]})
        clouds = PROTOCOLS[self.protocol]()
        method: Any = DefaultRecipe(clouds_config=clouds) if column is None else PaperRecipe(column, clouds)
        report = train(self.out, config, method, self.calibrate_only, self.init, self.rendered)
        return self.end(resumed, report=report)
