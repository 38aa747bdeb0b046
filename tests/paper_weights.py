"""Weights of the paper's estimator as its training writes them, of a network that has learnt nothing."""

from __future__ import annotations

from pathlib import Path

import torch

from toolee_robot.perception.pose.tooleenet import COLUMNS
from toolee_robot.perception.pose.tooleenet.estimator import save
from toolee_robot.perception.pose.tooleenet.network import PaperNet


def untrained_paper_weights(folder: Path, column: str = "symmetry-aware", seed: int = 0) -> Path:
    """Write them."""
    torch.manual_seed(seed)
    save(folder, PaperNet(COLUMNS[column].dim), COLUMNS[column], {})
    return folder
