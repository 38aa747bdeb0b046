"""How the pose network is trained."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from toolee_robot.perception.training.options import TrainingOptions


@dataclass(frozen=True, kw_only=True)
class TrainConfig(TrainingOptions):
    """The options of a training of the pose network.

    Attributes:
        reuse: How often a cloud is shown.
        chunk: Clouds made at a time.
        capacity: Clouds kept to draw from.
        first_fill: Clouds made before the first step.
        train_seeds: Tools of each kind to learn from.
        test_seeds: Held-out tools of each kind.
        validation: Held-out clouds.
        freeze_batchnorm: Share of the budget after which batch normalisation keeps its statistics (`freeze_batchnorm`;
        networks
            without it do not mind).
        rendered_share: Of the clouds, where rendered ones are given.
        init_share: Of the weights that it starts from in those that it ends with, where it starts from some (Wortsman
            et al., "Robust fine-tuning of zero-shot models", CVPR 2022).
    """

    USUAL_MINUTES: ClassVar[float] = 9.0

    batch: int = 512
    warmup_steps: int = 300
    weight_decay: float = 1e-4
    clip_norm: float = 1.0
    reuse: float = 4.0
    chunk: int = 2048
    capacity: int = 65_536
    first_fill: int = 8192
    train_seeds: int = 480
    test_seeds: int = 30
    validation: int = 4096
    freeze_batchnorm: float = 0.25
    rendered_share: float = 0.5
    init_share: float = 0.0
