"""`toolee train segmentation` and `toolee train refinement`: the networks trained on images."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import tyro

from toolee_robot.cli.train.options import (
    CHECKPOINT,
    CONFIG,
    Count,
    Folder,
    Number,
    TrainingCommand,
    options_of,
    remember,
)
from toolee_robot.errors import UserError

if TYPE_CHECKING:
    from toolee_robot.perception.offline.training.image_training import ImageTraining

Training = TypeVar("Training", bound="ImageTraining")

_REFINEMENT_CONFIG = "refinement_config.json"
"""Configuration file of the refiner, which may share the detector's folder."""


@dataclass(frozen=True)
class _Data:
    data: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """The training split of a data set, which may still be growing."""


@dataclass(frozen=True)
class _ImageCommand(TrainingCommand, _Data):
    """Options that both commands share."""

    def _begin(
        self, kind: type[Training], checkpoint: str, config: str = CONFIG, **own: Path | None
    ) -> tuple[Training, bool]:
        """Set up a training and store its options.

        Returns the training and whether it continues from a checkpoint; `own` are options that no file may give.
        """
        if not self.data.is_dir():
            raise UserError(
                f"--data {self.data} is not a folder: make it with `toolee dataset generate`",
                code="user.data_not_a_folder",
            )
        names = {f.name for f in fields(kind)} - {"data", "out", "model", "init", *own}
        options: dict[str, Any] = options_of(self, self.config, names) | own
        training = kind(self.data, self.out, init=self.init, **options)
        resumed = (self.out / checkpoint).is_file()
        about = {name: getattr(training, name) for name in sorted(names)}
        about |= {name: None if path is None else str(path) for name, path in own.items()}
        remember(self.out, resumed, about, config)
        return training, resumed


@dataclass(frozen=True)
class Segmentation(_ImageCommand):
    """Train the detector (masks of end effectors and tools).

    Example: toolee train segmentation --data data/hard/train --out runs/segmentation --minutes 20

    The same command again continues from the last checkpoint in DIR. Several GPUs: torchrun --no-python
    --nproc-per-node 4 toolee train segmentation, with the same options.
    """

    minutes: Number = None
    """Wall-clock of the optimisation (default: 12)."""
    batch: Count = None
    """Images a GPU (default: 32)."""
    wide: Number = None
    """Share of images with apparent sizes from 0.35 to 4 times the rendered ones; above 0, all images also get bright,
    plain and worn tools, stickers and print on them, coloured and mixed light, and the effects of cameras and depth
    sensors (default: 0)."""
    backgrounds: Folder = None
    """Folder of photographs without tools, put behind, beside and on the rendered ones; it needs --wide."""
    init_share: Number = None
    """Share of the weights of --init in the exported ones (default: 0)."""

    def run(self) -> int:
        from toolee_robot.perception.offline.detection.trainer import SegmentationTraining, train

        training, resumed = self._begin(SegmentationTraining, CHECKPOINT, backgrounds=self.backgrounds)
        train(training)
        return self.end(resumed)


@dataclass(frozen=True)
class Refinement(_ImageCommand):
    """Train the refiner, which segments again, in enlarged crops, the end effectors that the detector found.

    Example: toolee train refinement --data data/refine/train --detector runs/segmentation --out runs/segmentation

    Take images that the detector was not trained on. The refiner is used where its weights lie beside the detector's:
    --out may be their folder. The same command again continues from the last checkpoint there. Several GPUs: torchrun
    --no-python --nproc-per-node 4 toolee train refinement, with the same options.
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
        from toolee_robot.perception.offline.detection.refiner_trainer import CHECKPOINT, RefinementTraining, train

        training, resumed = self._begin(RefinementTraining, CHECKPOINT, _REFINEMENT_CONFIG, detector=self.detector)
        train(training)
        return self.end(resumed)
