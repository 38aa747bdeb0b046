"""Options of every training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from toolee_robot.errors import UserError


@dataclass(frozen=True, kw_only=True)
class TrainingOptions:
    """The options of every training.

    Attributes:
        minutes: Wall-clock budget of the optimisation; with `max_steps`, whichever ends first. None: `USUAL_MINUTES`,
            or, with `max_steps`, no limit.
        max_steps: Budget in steps.
        session_minutes: Part of the budget that this process uses (None: all that is left); the next one resumes.
        batch: Examples per step and rank.
        lr: Learning rate after the warm-up, decayed over the budget as a cosine.
        warmup_steps: Steps over which the learning rate rises.
        weight_decay: Weight decay of AdamW.
        clip_norm: Largest norm of the gradient.
        ema: Decay of the averaged weights, which are exported.
        seed: Seed of weights, order and augmentation.
        device: "cpu", "cuda", "cuda:1"; "auto": a GPU if there is one, under torchrun one per process.
        checkpoint_minutes: Time between checkpoints [min].
        log_every: Steps between readings of the clock and the loss, each of which waits for the GPU.
        compile: Whether the network is compiled on a GPU.
    """

    USUAL_MINUTES: ClassVar[float] = 12.0
    """Default budget [min]."""

    minutes: float | None = None
    max_steps: int | None = None
    session_minutes: float | None = None
    batch: int = 32
    lr: float = 1e-3
    warmup_steps: int = 200
    weight_decay: float = 0.05
    clip_norm: float = 10.0
    ema: float = 0.999
    seed: int = 0
    device: str = "auto"
    checkpoint_minutes: float = 2.0
    log_every: int = 20
    compile: bool = True

    def __post_init__(self) -> None:
        if self.minutes is not None and self.minutes <= 0:
            raise UserError("minutes must be positive", code="user.minutes")
        if not (self.batch > 0 and self.lr > 0 and 0 < self.ema < 1):
            raise UserError("batch and lr must be positive, ema between 0 and 1", code="user.training_options")

    def progress(self, minutes: float, steps: int) -> float:
        """Share of the budget that is used.

        Args:
            minutes: Time used [min].
            steps: Steps done.

        Returns:
            The share, 1 at the end of the budget.
        """
        by_steps = steps / self.max_steps if self.max_steps else 0.0
        limit = self.minutes if self.minutes is not None else None if self.max_steps else self.USUAL_MINUTES
        return by_steps if limit is None else max(by_steps, minutes / limit)
