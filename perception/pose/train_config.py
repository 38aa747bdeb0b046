"""How the pose network is trained."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TrainConfig:
    """minutes: wall-clock of the optimisation; max_steps: if not 0, the budget is in steps instead. The learning rate
    follows a cosine over it. session_minutes: how much of it this process does (0: all that is left); the next one
    resumes. reuse: how often a cloud is shown. train_seeds, test_seeds: tools of each kind, training and held out.
    settle: the share of the budget after which batch normalisation keeps its statistics (`settled_norms`; networks
    without it do not mind). rendered_share: of the clouds, where rendered ones are given. init_share: of the weights
    that it starts from in those that it ends with, where it starts from some (Wortsman et al., "Robust fine-tuning of
    zero-shot models", CVPR 2022)."""

    minutes: float = 9.0
    max_steps: int = 0
    session_minutes: float = 0.0
    batch: int = 512
    learning_rate: float = 1e-3
    warm_up: int = 300
    weight_decay: float = 1e-4
    clip: float = 1.0
    ema: float = 0.999
    reuse: float = 4.0
    chunk: int = 2048
    capacity: int = 65_536
    first_fill: int = 8192
    train_seeds: int = 480
    test_seeds: int = 30
    validation: int = 4096
    settle: float = 0.25
    rendered_share: float = 0.5
    init_share: float = 0.0
    checkpoint_seconds: float = 120.0
    compile: bool = True
    seed: int = 0
