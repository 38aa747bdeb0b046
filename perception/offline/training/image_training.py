"""Trainings on the images of a data set that may still grow."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import torch

from toolee_robot.errors import UserError
from toolee_robot.perception.offline.dataset.spec import refuse_test_set
from toolee_robot.perception.offline.training.loop import TrainingRun
from toolee_robot.perception.offline.training.options import CHECKPOINT, CONFIG, TrainingOptions, options_of, remember
from toolee_robot.perception.weight_files import save_weights


@dataclass(frozen=True)
class ImageTraining(TrainingOptions):
    """A training on the images of a data set.

    Attributes:
        data: Folder of a split.
        out: Folder for checkpoint, weights and log; a run whose checkpoint lies there goes on.
        init: Folder of exported weights to start from.
        patience: How long to wait for the first scene of a data set that is still being generated [s].

    Raises:
        UserError: The data are a test set, or a value is out of range.
    """

    data: Path
    out: Path
    init: Path | None = None
    patience: float = 120.0

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_test_set(self.data)

    def to_json(self) -> dict[str, Any]:
        """The options as a JSON object, without paths of this machine."""
        return {**asdict(self), "data": self.data.name, "out": self.out.name, "init": self.init is not None}


Training = TypeVar("Training", bound=ImageTraining)


def begin(
    kind: type[Training],
    given: dict[str, Any],
    checkpoint: str = CHECKPOINT,
    config: str = CONFIG,
    **own: Path | None,
) -> tuple[Training, bool]:
    """Set up a training and store its options.

    Args:
        kind: The training.
        given: Options of the command line, "data", "out", "init" and "config" (a file of options) among them.
        checkpoint: Name of its checkpoint.
        config: Name of the file that keeps its options.
        **own: Options that no file may give.

    Returns:
        The training, and whether it continues from a checkpoint.

    Raises:
        UserError: The data are missing or a test set, an option is unknown, or another one than when it began.
    """
    data, out = given["data"], given["out"]
    if not data.is_dir():
        raise UserError(
            f"--data {data} is not a folder: make it with `toolee dataset generate`", code="user.data_not_a_folder"
        )
    names = {f.name for f in fields(kind)} - {"data", "out", "model", "init", *own}
    options = options_of(given, given["config"], names) | own
    training = kind(data, out, init=given["init"], **options)
    resumed = (out / checkpoint).is_file()
    about = {name: getattr(training, name) for name in sorted(names)}
    about |= {name: None if path is None else str(path) for name, path in own.items()}
    remember(out, resumed, about, config)
    return training, resumed


class ImageTrainingRun(TrainingRun):
    """A training on images; more may be added while it runs."""

    config: ImageTraining

    @abstractmethod
    def images(self) -> int:
        """Number of images of this rank."""

    @abstractmethod
    def extend(self) -> None:
        """Add the images that have been decoded since."""

    @abstractmethod
    def described(self) -> dict[str, Any]:
        """Description of the network, stored beside the weights."""

    def grow(self) -> dict[str, float]:
        """See `TrainingRun`: add images; their number over all ranks."""
        self.extend()
        return {"images": self.images() * self.distributed.world}

    def write(self) -> None:
        """Write the averaged weights as safetensors, with configuration and log as JSON."""
        description = {
            **self.described(),
            "training": self.config.to_json(),
            "steps": self.step,
            "minutes": self.elapsed / 60,
            "images": self.images() * self.distributed.world,
            "device": self.distributed.device_name,
            "torch": torch.__version__,
            "log": self.log[:: max(1, len(self.log) // 200)],
        }
        save_weights(self.out, self.name, self.averaged(), description)
        print(f"{self.name}: wrote {self.out / self.name}*.safetensors after {self.step} steps", flush=True)
