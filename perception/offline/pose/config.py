"""Options of the pose network's training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from toolee_robot.perception.offline.training.options import TrainingOptions


@dataclass(frozen=True, kw_only=True)
class TrainConfig(TrainingOptions):
    """The options of a training of the pose network.

    Attributes:
        batch: Clouds per step and rank.
        warmup_steps: See `TrainingOptions`, as the next two.
        weight_decay: Weight decay of AdamW.
        clip_norm: Largest norm of the gradient.
        reuse: How often a cloud is shown.
        chunk: Clouds generated at a time.
        capacity: Clouds in the replay buffer.
        first_fill: Clouds generated before the first step.
        train_seeds: Training tools of each kind.
        test_seeds: Held-out tools of each kind.
        validation: Held-out clouds.
        rendered_share: Share of rendered clouds, where some are given.
        init_share: Share of the initial weights in the final ones, where the training starts from weights (Wortsman et
            al., "Robust fine-tuning of zero-shot models", CVPR 2022).

    """

    USUAL_MINUTES: ClassVar[float] = 9.0
    """Default budget [min]."""

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
    rendered_share: float = 0.5
    init_share: float = 0.0
