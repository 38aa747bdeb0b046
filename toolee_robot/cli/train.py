"""Train the detector, its masks' refiner or the pose network, or fit the trust in their poses.

Example: toolee train segmentation --data data/hard/train --out runs/seg
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from toolee_robot.cli.output import Flag, JsonOption, progress_bars
from toolee_robot.errors import UserError

OutDir = Annotated[Path, tyro.conf.arg(metavar="DIR")]
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]
Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
Number = Annotated[float | None, tyro.conf.arg(metavar="X", help_behavior_hint="")]
Count = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")]


@dataclass(frozen=True)
class _Training(JsonOption):
    """Options of every training."""

    out: OutDir
    """Checkpoint, weights with their configuration, log."""
    config: File = None
    """YAML or JSON of further options, such as batch, lr and checkpoint_minutes. Options on the command line win."""
    minutes: Number = None
    """Wall-clock of the optimisation."""
    max_steps: Count = None
    """Budget in steps; with --minutes too, whichever ends first."""
    seed: Count = None
    """Seed of weights, order and augmentation (default: 0)."""
    device: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """cpu, cuda, cuda:1 (default: a GPU if there is one)."""
    init: Folder = None
    """Start from the weights exported there."""

    def _given(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def _end(self, resumed: bool, **more: Any) -> int:
        """Print the result if --json is given; return the exit code."""
        from toolee_robot.perception.offline.training.options import is_first

        if is_first():
            self.tell({"out": str(self.out), "resumed": resumed, **more})
        return 0


@dataclass(frozen=True)
class _Data:
    data: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """The training split of a data set, which may still be growing."""


@dataclass(frozen=True)
class Segmentation(_Training, _Data):
    """Train the detector (masks of end effectors and tools).

    Example: toolee train segmentation --data data/hard/train --out runs/segmentation --minutes 20

    The same command again continues from the last checkpoint in DIR. Several GPUs: torchrun --no-python
    --nproc-per-node 4 toolee train segmentation, with the same options.
    """

    minutes: Number = None
    """Wall-clock of the optimisation (default: 12)."""
    wide: Number = None
    """Share of images with apparent sizes from 0.35 to 4 times the rendered ones; above 0, all images also get bright,
    plain and worn tools, stickers and print on them, coloured and mixed light, and the effects of cameras and depth
    sensors (default: 0)."""
    backgrounds: Folder = None
    """Folder of photographs without tools, put behind, beside and on the rendered ones; it needs --wide."""
    init_share: Number = None
    """Share of the weights of --init in the exported ones (default: 0)."""

    def run(self) -> int:
        from toolee_robot.perception.offline.training.detector_training import SegmentationTraining, train
        from toolee_robot.perception.offline.training.image_training import begin

        training, resumed = begin(SegmentationTraining, self._given(), backgrounds=self.backgrounds)
        train(training)
        return self._end(resumed)


@dataclass(frozen=True)
class Refinement(_Training, _Data):
    """Train the refiner of the detector's masks.

    The refiner segments each detected end effector again, in an enlarged crop.

    Example: toolee train refinement --data data/refine/train --detector runs/segmentation --out runs/segmentation

    Take images that the detector was not trained on. The refiner is used where its weights lie beside the detector's:
    --out may be their folder. The same command again continues from the last checkpoint there. Several GPUs: torchrun
    --no-python --nproc-per-node 4 toolee train refinement, with the same options.
    """

    minutes: Number = None
    """Wall-clock, from the first scene on (default: 15)."""
    detector: Folder = None
    """The detector's weights (default: those that ship)."""

    def run(self) -> int:
        from toolee_robot.perception.offline.training.image_training import begin
        from toolee_robot.perception.offline.training.refiner_training import CHECKPOINT, RefinementTraining, train

        training, resumed = begin(
            RefinementTraining, self._given(), CHECKPOINT, "refinement_config.json", detector=self.detector
        )
        train(training)
        return self._end(resumed)


@dataclass(frozen=True)
class Clouds(JsonOption):
    """Keep a data set's clouds for the pose network.

    Each end effector gives a cloud by its true mask and one by the detector's mask.

    Example: toolee train clouds data/hard/train --out runs/clouds.npz --workers 2

    Take images that the detector was not trained on. The paper's estimator learns from true masks alone.
    """

    data: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """A data set, or one split of it."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """Where the clouds go, for `toolee train pose --rendered FILE` or `toolee train paper FILE`."""
    true_masks: Flag = False
    """Under true masks alone, without a detector."""
    weights: Folder = None
    """The detector's weights (default: those that ship)."""
    limit: Count = None
    """Images of each split (default: all)."""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 1
    """Processes at a time."""
    device: Annotated[str, tyro.conf.arg(metavar="NAME")] = "cpu"
    """Where the detector runs: cpu, cuda:1, or cuda: spread over all GPUs."""

    def run(self) -> int:
        console = self.console
        from toolee_robot.perception.offline.rendered_clouds import rendered_clouds
        from toolee_robot.perception.offline.training.options import make_folder

        if self.weights is not None and self.true_masks:
            raise UserError("leave --weights out: true masks need no detector")
        make_folder(self.out.parent)
        with progress_bars(console) as report:
            clouds = rendered_clouds(
                self.data,
                self.weights,
                self.device,
                self.workers,
                self.limit,
                partial(report, "scene folders"),
                self.true_masks,
            )
        clouds.save(self.out)
        shown = int(clouds.positive.sum())
        negatives = "" if self.true_masks else f" and {len(clouds) - shown} of other objects"
        console.print(f"{shown} clouds of end effectors{negatives} in {self.out}")
        self.tell({"out": str(self.out), "positive": shown, "negative": len(clouds) - shown})
        return 0


@dataclass(frozen=True)
class Pose(_Training):
    """Train the pose network.

    Clouds of generated tools are made during the training.

    Example: toolee train pose --out runs/pose --minutes 20

    The same command again continues from the last checkpoint in DIR. Several GPUs: torchrun --no-python
    --nproc-per-node 4 toolee train pose, with the same options.
    """

    minutes: Number = None
    """Wall-clock of the optimisation (default: 9)."""
    rendered: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = ()
    """Clouds of rendered images to mix in, made by `toolee train clouds`."""
    init_share: Number = None
    """Share of the weights of --init in the exported ones (default: 0)."""
    train_seeds: Count = None
    """Tools of each kind to learn from (default: 480)."""

    def run(self) -> int:
        from toolee_robot.perception.offline.training.options import CHECKPOINT, options_of, remember
        from toolee_robot.perception.offline.training.pose_training import TrainConfig, train

        config = TrainConfig(**options_of(self._given(), self.config, {f.name for f in fields(TrainConfig)}))
        resumed = (self.out / CHECKPOINT).is_file()
        about = {f.name: getattr(config, f.name) for f in fields(TrainConfig)}
        remember(self.out, resumed, {**about, "rendered": [str(path) for path in self.rendered]})
        report = train(self.out, config, self.init, self.rendered)
        return self._end(resumed, report=report)


@dataclass(frozen=True)
class Paper(JsonOption):
    """Train a column of the paper's Table I.

    It trains as the published code does: 2,000 epochs, batches of 600.

    Example: toolee train paper runs/ends.npz --out runs/aware --minutes 9

    The same command again continues from the last checkpoint in DIR. An interrupted training gives the same weights as
    one without a break.
    """

    clouds: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILE", help_behavior_hint="")]
    """Clouds by true masks: `python -m benchmarks.published_clouds`, or `toolee train clouds --true-masks`."""
    out: OutDir
    """Checkpoint, weights with their configuration, log."""
    column: Annotated[str, tyro.conf.arg(metavar="NAME")] = "symmetry-aware"
    """object-prior, ee or symmetry-aware. ee-symmetry-prior is ee, judged with the symmetry."""
    config: File = None
    """YAML or JSON of further options: epochs, batch, lr, freeze_epochs, judged, seed."""
    minutes: Number = None
    """Stop after this time. The same command continues."""
    device: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """cpu, cuda, cuda:1 (default: a GPU if there is one)."""
    init: Folder = None
    """Start from the weights exported there, of the same column."""

    def run(self) -> int:
        from toolee_robot.perception.offline.research.tooleenet_training import PaperOptions, train_column
        from toolee_robot.perception.offline.training.options import CHECKPOINT, options_of, remember

        given = {"session_minutes": self.minutes, "device": self.device}
        options = PaperOptions(**options_of(given, self.config, {f.name for f in fields(PaperOptions)}))
        resumed = (self.out / CHECKPOINT).is_file()
        about = {f.name: getattr(options, f.name) for f in fields(PaperOptions)}
        about |= {"column": self.column, "clouds": [str(path) for path in self.clouds], "init": str(self.init)}
        remember(self.out, resumed, about)
        done = train_column(self.out, options, self.column, self.clouds, self.init)
        self.tell({"out": str(self.out), "resumed": resumed, **done})
        return 0


@dataclass(frozen=True)
class Trust(JsonOption):
    """Fit how probable it is that detection and pose are right.

    It holds for poses from the detector's masks, so train both networks first.

    Example: toolee train trust --data data/hard-trust/train --weights runs/both --workers 2

    Take data that neither network was trained on, and that no result uses.
    """

    data: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """A data set, or one split of it."""
    weights: File = None
    """Folder with the weights of both networks, where trust.json goes, too (default: those that ship)."""
    frames: Annotated[int, tyro.conf.arg(metavar="N")] = 1000
    """Number of frames without a tool, which the command renders."""
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Seed of the frames without a tool."""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 1
    """Processes at a time."""

    def run(self) -> int:
        console = self.console
        from toolee_robot.perception.offline.fit_trust import fit_trust

        with progress_bars(console) as report_progress:
            report = fit_trust(
                self.data,
                self.weights,
                self.frames,
                self.seed,
                self.workers,
                partial(report_progress, "scene folders, then frames without a tool"),
            )
        console.print(
            f"Fitted on {report['poses']} poses in {report['images']} images and on "
            f"{report['frames_without_a_tool']} frames without a tool.\nShare of usable poses that are right: "
            f"{report['usable_right']:.3f}. Share of right poses that are usable: {report['right_usable']:.3f}. "
            f"Share of frames without a tool that give no pose: {report['quiet']:.3f}."
        )
        self.tell(report)
        return 0


COMMANDS = {
    "train": {
        "segmentation": Segmentation,
        "refinement": Refinement,
        "clouds": Clouds,
        "pose": Pose,
        "paper": Paper,
        "trust": Trust,
    }
}
