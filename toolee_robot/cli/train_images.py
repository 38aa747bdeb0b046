"""`toolee train segmentation` and `toolee train refinement`: the networks that learn from images."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import tyro

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.cli.train_options import CONFIG, Count, File, Folder, Number, OutDir, options_of, remember
from toolee_robot.errors import UserError

if TYPE_CHECKING:
    from toolee_robot.perception.training_run import ImageTraining

Training = TypeVar("Training", bound="ImageTraining")

_REFINEMENT_CONFIG = "refinement_config.json"
"""The refiner's, which may be trained into its detector's folder."""


@dataclass(frozen=True)
class _ImageCommand:
    """What both have; the three without a word say theirs themselves, and stand in this order in their help."""

    data: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """The training split of a data set, which may still be growing."""
    out: OutDir
    """Checkpoint, weights with their configuration, log, TensorBoard curves (extra `train`)."""
    config: File = None
    """YAML or JSON of options, any subset; the command line's win."""
    minutes: Number = None
    batch: Count = None
    lr: Number = None
    max_steps: Count = None
    """End after so many steps, if that is sooner."""
    seed: Count = None
    """Of weights, order and augmentation (default: 0)."""
    checkpoint_minutes: Number = None
    """Between checkpoints (default: 2)."""
    device: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """cpu, cuda, cuda:1 (default: a GPU if there is one)."""
    init: Folder = None
    """Start from the weights exported there."""
    json: Flag = False
    """Print one line of JSON last on standard output."""

    def _begin(self, kind: type[Training], checkpoint: str, config: str = CONFIG, **own: Path | None) -> Training:
        """The training, its options remembered; it resumes where there is a checkpoint. own: further options, which no
        file gives."""
        if not self.data.is_dir():
            raise UserError(f"--data {self.data} is not a folder: make it with `toolee dataset generate`")
        names = {f.name for f in fields(kind)} - {"data", "out", "resume", "model", "init", *own}
        options: dict[str, Any] = options_of(self, self.config, names)
        resume = (self.out / checkpoint).is_file()
        options |= {**own, "resume": resume, "init": None if resume else self.init}
        training = kind(self.data, self.out, **options)
        about = {name: getattr(training, name) for name in sorted(names)}
        about |= {name: None if path is None else str(path) for name, path in own.items()}
        remember(self.out, resume, about, config)
        return training

    def _end(self, training: ImageTraining) -> int:
        if self.json:
            print(json_line({"out": str(self.out), "resumed": training.resume}), flush=True)
        return 0


@dataclass(frozen=True)
class Segmentation(_ImageCommand):
    """Train the detector (masks of end effectors and tools).

    Example: toolee train segmentation --data data/hard/train --out runs/segmentation --minutes 20

    The same command again continues from the last checkpoint in DIR. Several GPUs: torchrun --nproc-per-node 4 -m
    toolee_robot.perception.train_segmentation, with the same options.
    """

    minutes: Number = None
    """Wall-clock of the optimisation (default: 12)."""
    batch: Count = None
    """Images a GPU (default: 32)."""
    lr: Number = None
    """Learning rate (default: 0.001)."""

    def run(self) -> int:
        from toolee_robot.perception.train_segmentation import CHECKPOINT, SegmentationTraining, train

        training = self._begin(SegmentationTraining, CHECKPOINT)
        train(training)
        return self._end(training)


@dataclass(frozen=True)
class Refinement(_ImageCommand):
    """Train the refiner, which draws again, near, the end effectors that the detector found.

    Example: toolee train refinement --data data/refine/train --detector runs/segmentation --out runs/segmentation

    Take images that the detector was not trained on. The refiner is used where its weights lie beside the detector's:
    --out may be their folder. The same command again continues from the last checkpoint there. Several GPUs: torchrun
    --nproc-per-node 4 -m toolee_robot.perception.train_refinement, with the same options.
    """

    minutes: Number = None
    """Wall-clock, from the first scene on (default: 15)."""
    batch: Count = None
    """Detections a GPU (default: 512)."""
    lr: Number = None
    """Learning rate (default: 0.002)."""
    detector: Folder = None
    """The detector's weights (default: those that ship)."""

    def run(self) -> int:
        from toolee_robot.perception.train_refinement import CHECKPOINT, RefinementTraining, train

        training = self._begin(RefinementTraining, CHECKPOINT, _REFINEMENT_CONFIG, detector=self.detector)
        train(training)
        return self._end(training)
