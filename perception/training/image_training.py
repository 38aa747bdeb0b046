"""Trainings on the images of a data set, of which there may come more meanwhile."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from toolee_robot.perception.training.loop import TrainingRun
from toolee_robot.perception.training.options import TrainingOptions
from toolee_robot.perception.weight_files import save_weights


@dataclass(frozen=True)
class ImageTraining(TrainingOptions):
    """A training on the images of a data set.

    Attributes:
        data: Folder of a split.
        out: Folder for checkpoint, weights and log; a run whose checkpoint lies there goes on.
        init: Folder of exported weights to start from.
        patience: How long to wait for the first scene of a data set that is still being generated [s].
    """

    data: Path
    out: Path
    init: Path | None = None
    patience: float = 120.0

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "data": self.data.name, "out": self.out.name, "init": self.init is not None}


class ImageTrainingRun(TrainingRun):
    """A training on images, of which there may come more while it runs."""

    config: ImageTraining

    @abstractmethod
    def images(self) -> int:
        """How many images this rank has."""

    @abstractmethod
    def extend(self) -> None:
        """Take in the images that have come."""

    @abstractmethod
    def described(self) -> dict[str, Any]:
        """What stands beside the weights, but for what every run knows of itself."""

    def grow(self) -> dict[str, float]:
        self.extend()
        return {"images": self.images() * self.distributed.world}

    def write(self) -> None:
        """Averaged weights as safetensors, configuration and log as JSON."""
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
