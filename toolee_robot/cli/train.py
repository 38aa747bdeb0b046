"""`toolee train`: the detector, what draws its masks again, the pose network, and how far they are to be trusted."""

from __future__ import annotations

import json
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
import yaml
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line, write_whole
from toolee_robot.errors import UserError

if TYPE_CHECKING:
    from toolee_robot.perception.pose.train_config import TrainConfig

_CONFIG = "config.json"
"""Beside the checkpoint: the configuration it was made with."""
_REFINEMENT_CONFIG = "refinement_config.json"
"""The refiner's, which may be trained into its detector's folder."""
_Out = Annotated[Path, tyro.conf.arg(metavar="DIR")]
_File = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]
_Number = Annotated[float | None, tyro.conf.arg(metavar="X", help_behavior_hint="")]
_Count = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")]


@dataclass(frozen=True)
class Segmentation:
    """Train the detector (masks of end effectors and tools).

    Example: toolee train segmentation --data data/hard/train --out runs/segmentation --minutes 20

    The same command again continues from the last checkpoint in DIR. Several GPUs: torchrun --nproc-per-node 4 -m
    toolee_robot.perception.train_segmentation, with the same options.
    """

    data: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """The training split of a data set, which may still be growing."""
    out: _Out
    """Checkpoint, weights with their configuration, log, TensorBoard curves (extra `train`)."""
    config: _File = None
    """YAML or JSON of options, any subset; the command line's win."""
    minutes: _Number = None
    """Wall-clock of the optimisation (default: 12)."""
    max_steps: _Count = None
    """End after so many steps, if that is sooner."""
    batch: _Count = None
    """Images a GPU (default: 32)."""
    lr: _Number = None
    """Learning rate (default: 0.001)."""
    seed: _Count = None
    """Of weights, order and augmentation (default: 0)."""
    checkpoint_minutes: _Number = None
    """Between checkpoints (default: 2)."""
    device: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """cpu, cuda, cuda:1 (default: a GPU if there is one)."""
    init: _File = None
    """Folder of exported weights to start from."""
    json: Flag = False
    """Print one line of JSON last on standard output."""

    def run(self) -> int:
        if not self.data.is_dir():
            raise UserError(f"--data {self.data} is not a folder: make it with `toolee dataset generate`")
        from toolee_robot.perception.train_segmentation import CHECKPOINT, SegmentationTraining, train

        names = {f.name for f in fields(SegmentationTraining)} - {"data", "out", "resume", "model", "init"}
        options = _options(self, self.config, names)
        resume = (self.out / CHECKPOINT).is_file()
        training = SegmentationTraining(
            self.data, self.out, resume=resume, init=None if resume else self.init, **options
        )
        _remember(self.out, resume, {name: getattr(training, name) for name in sorted(names)})
        train(training)
        if self.json:
            print(json_line({"out": str(self.out), "resumed": resume}), flush=True)
        return 0


@dataclass(frozen=True)
class Refinement:
    """Train the refiner, which draws again, near, the end effectors that the detector found.

    Example: toolee train refinement --data data/refine/train --detector runs/segmentation --out runs/segmentation

    Take images that the detector was not trained on. The refiner is used where its weights lie beside the detector's:
    --out may be their folder. The same command again continues from the last checkpoint there. Several GPUs: torchrun
    --nproc-per-node 4 -m toolee_robot.perception.train_refinement, with the same options.
    """

    data: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """The training split of a data set, which may still be growing."""
    out: _Out
    """Checkpoint, weights with their configuration, validation and log, TensorBoard curves (extra `train`)."""
    config: _File = None
    """YAML or JSON of options, any subset; the command line's win."""
    minutes: _Number = None
    """Wall-clock, from the first scene on (default: 15)."""
    max_steps: _Count = None
    """End after so many steps, if that is sooner."""
    batch: _Count = None
    """Detections a GPU (default: 512)."""
    lr: _Number = None
    """Learning rate (default: 0.002)."""
    seed: _Count = None
    """Of weights, order and augmentation (default: 0)."""
    checkpoint_minutes: _Number = None
    """Between checkpoints (default: 2)."""
    device: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """cpu, cuda, cuda:1 (default: a GPU if there is one)."""
    detector: _File = None
    """Folder with the detector's weights (default: those that ship)."""
    init: _File = None
    """Folder of a refiner's exported weights to start from."""
    json: Flag = False
    """Print one line of JSON last on standard output."""

    def run(self) -> int:
        if not self.data.is_dir():
            raise UserError(f"--data {self.data} is not a folder: make it with `toolee dataset generate`")
        from toolee_robot.perception.train_refinement import CHECKPOINT, RefinementTraining, train

        names = {f.name for f in fields(RefinementTraining)} - {"data", "out", "resume", "model", "detector", "init"}
        options = _options(self, self.config, names)
        resume = (self.out / CHECKPOINT).is_file()
        training = RefinementTraining(
            self.data, self.out, resume=resume, detector=self.detector, init=None if resume else self.init, **options
        )
        about = {name: getattr(training, name) for name in sorted(names)}
        detector = None if self.detector is None else str(self.detector)
        _remember(self.out, resume, {**about, "detector": detector}, _REFINEMENT_CONFIG)
        train(training)
        if self.json:
            print(json_line({"out": str(self.out), "resumed": resume}), flush=True)
        return 0


@dataclass(frozen=True)
class Pose:
    """Train the pose network on clouds that are made as they are needed.

    Example: toolee train pose --out runs/pose --minutes 20

    The same command again continues from the last checkpoint in DIR. Several GPUs: torchrun --nproc-per-node 4 -m
    toolee_robot.perception.train_pose, with the same options.
    """

    out: _Out
    """Checkpoint, weights with configuration and calibration, log, TensorBoard curves (extra `train`)."""
    config: _File = None
    """YAML or JSON of options, any subset of those of toolee_robot.perception.train_pose; the command line's win."""
    estimator: Literal["ours", "paper"] = "ours"
    """paper: ToolEENet's own."""
    column: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """Of the paper's Table I, for --estimator paper (default: symmetry-aware)."""
    protocol: Literal["hard", "paper"] = "hard"
    """Which data set's views the clouds are like."""
    minutes: _Number = None
    """Wall-clock of the optimisation (default: 9)."""
    max_steps: _Count = None
    """Budget in steps instead of minutes."""
    batch: _Count = None
    """Clouds a step (default: 512)."""
    learning_rate: _Number = None
    """(default: 0.001)"""
    seed: _Count = None
    """Of weights, clouds and order (default: 0)."""
    checkpoint_seconds: _Number = None
    """Between checkpoints (default: 120)."""
    hands: _File = None
    """Hand samples, for machines without the hand's model."""
    rendered: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = ()
    """Clouds of rendered images to mix in, made by `toolee train clouds`."""
    json: Flag = False
    """Print one line of JSON last on standard output."""

    def run(self) -> int:
        from toolee_robot.perception.pose.cloud_batch import PROTOCOLS
        from toolee_robot.perception.pose.method import Ours
        from toolee_robot.perception.pose.paper import COLUMNS, PaperMethod
        from toolee_robot.perception.pose.train_config import TrainConfig
        from toolee_robot.perception.pose.training import train

        if self.column is not None and (self.estimator != "paper" or self.column not in COLUMNS):
            raise UserError(f"--column {self.column}: with --estimator paper one of {', '.join(COLUMNS)}")
        options = _options(self, self.config, {f.name for f in fields(TrainConfig) if f.default is not MISSING})
        config: TrainConfig = TrainConfig(**options)
        resume = (self.out / "checkpoint.pt").is_file()
        column = (self.column or "symmetry-aware") if self.estimator == "paper" else None
        about = {f.name: getattr(config, f.name) for f in fields(TrainConfig)}
        about |= {"estimator": self.estimator, "column": column, "protocol": self.protocol}
        _remember(self.out, resume, {**about, "rendered": [str(path) for path in self.rendered]})
        clouds = PROTOCOLS[self.protocol]()
        method: Any = Ours(clouds_config=clouds) if column is None else PaperMethod(COLUMNS[column], clouds)
        report = train(self.out, config, method, self.hands, rendered=self.rendered)
        if self.json:
            print(json_line({"out": str(self.out), "resumed": resume, "report": report}), flush=True)
        return 0


@dataclass(frozen=True)
class Trust:
    """Fit how far a pose under the detector's mask is to be trusted, once both networks are trained.

    Example: toolee train trust --data data/hard-trust/train --weights runs/both --workers 2

    Take data that neither network was trained on, and that nothing is reported on.
    """

    data: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """A data set, or one split of it."""
    weights: _File = None
    """Folder with the weights of both networks, where trust.json goes, too (default: those that ship)."""
    frames: Annotated[int, tyro.conf.arg(metavar="N")] = 1000
    """Without a tool, to render beside."""
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Of these frames."""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 1
    """Processes at a time."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        console = Console(stderr=self.json, highlight=False)
        from toolee_robot.perception.fit_trust import fit_trust

        with console.status("loading the networks") as status:
            report = fit_trust(
                self.data,
                self.weights,
                self.frames,
                self.seed,
                self.workers,
                lambda done, of: status.update(f"{done} of {of}: scene folders, then frames without a tool"),
            )
        console.print(
            f"fitted on {report['poses']} poses in {report['images']} images and {report['frames_without_a_tool']} "
            f"frames without a tool\n{report['usable_right']:.3f} of the usable poses are right, "
            f"{report['right_usable']:.3f} of the right ones usable; {report['quiet']:.3f} of the frames without a "
            "tool give none"
        )
        if self.json:
            print(json_line(report), flush=True)
        return 0


@dataclass(frozen=True)
class Clouds:
    """Keep the clouds of a data set's images, under true masks and the detector's, for the pose network's training.

    Example: toolee train clouds data/hard/train --out runs/clouds.npz --workers 2

    Take images that the detector was not trained on.
    """

    data: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """A data set, or one split of it."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """Where the clouds go, for `toolee train pose --rendered FILE`."""
    weights: _File = None
    """Folder with the detector's weights (default: those that ship)."""
    limit: _Count = None
    """Images of each split (default: all)."""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 1
    """Processes at a time."""
    device: Annotated[str, tyro.conf.arg(metavar="NAME")] = "cpu"
    """Where the detector runs: cpu, cuda, cuda:1."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        console = Console(stderr=self.json, highlight=False)
        from toolee_robot.perception.rendered_clouds import rendered_clouds

        # Before the work: it may take hours.
        _make_folder(self.out.parent)
        with console.status("loading the detector") as status:
            clouds = rendered_clouds(
                self.data,
                self.weights,
                self.device,
                self.workers,
                self.limit,
                lambda done, of: status.update(f"{done} of {of} scene folders"),
            )
        clouds.save(self.out)
        shown = int(clouds.positive.sum())
        console.print(f"{shown} clouds of end effectors and {len(clouds) - shown} of what is none in {self.out}")
        if self.json:
            print(json_line({"out": str(self.out), "positive": shown, "negative": len(clouds) - shown}), flush=True)
        return 0


_Action = (
    Annotated[Segmentation, tyro.conf.subcommand("segmentation")]
    | Annotated[Refinement, tyro.conf.subcommand("refinement")]
    | Annotated[Clouds, tyro.conf.subcommand("clouds")]
    | Annotated[Pose, tyro.conf.subcommand("pose")]
    | Annotated[Trust, tyro.conf.subcommand("trust")]
)


@dataclass(frozen=True)
class Train:
    """Train the detector, its masks' refiner or the pose network, or fit how far they are to be trusted.

    Example: toolee train segmentation --data data/hard/train --out runs/segmentation
    """

    action: Annotated[_Action, tyro.conf.arg(name="")]

    def run(self) -> int:
        return self.action.run()


def _options(command: Segmentation | Refinement | Pose, file: Path | None, names: set[str]) -> dict[str, Any]:
    """The training's options: those of the file, then those of the command line."""
    options: dict[str, Any] = {}
    if file is not None:
        try:
            read = yaml.safe_load(file.read_text())  # JSON is YAML
        except (OSError, yaml.YAMLError) as error:
            raise UserError(f"--config {file}: cannot be read ({error})") from error
        if not isinstance(read, dict) or (unknown := sorted(set(map(str, read)) - names)):
            what = f"has no option {', '.join(unknown)}" if isinstance(read, dict) else "is no mapping of options"
            raise UserError(f"--config {file}: {what}; there are {', '.join(sorted(names))}")
        options |= read
    given = {f.name: getattr(command, f.name) for f in fields(command) if f.name in names}
    return options | {name: value for name, value in given.items() if value is not None}


def _remember(out: Path, resume: bool, config: dict[str, Any], name: str = _CONFIG) -> None:
    """Store the configuration, or check that a run goes on with the one it began with."""
    path = out / name
    if resume and path.is_file():
        before = json.loads(path.read_text())
        # How long it goes on may change; what is learnt from may not.
        changed = {k for k in before.keys() | config.keys() if before.get(k) != config.get(k)} - _MAY_CHANGE
        if changed:
            raise UserError(
                f"{out} was begun with another {', '.join(sorted(changed))} ({path}): use those values or another --out"
            )
    _make_folder(out)
    write_whole(path, (json.dumps(config, indent=1, default=str) + "\n").encode())


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the folder {folder}: {error.strerror or error}") from error


_MAY_CHANGE = {
    "minutes",
    "max_steps",
    "session_minutes",
    "device",
    "checkpoint_minutes",
    "checkpoint_seconds",
    "patience",
}
